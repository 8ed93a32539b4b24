"""A whole class: submissions in, grades out."""
