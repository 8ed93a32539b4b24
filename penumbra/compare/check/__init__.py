"""What is wrong with a student's renderer, told from its pictures."""
