"""The exact image, in closed form. It owes nothing to C."""
