"""grades.json in the words of the tools that instructors have."""
