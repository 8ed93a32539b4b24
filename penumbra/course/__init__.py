"""The lesson and what a teacher hands out. It computes nothing of its own."""
