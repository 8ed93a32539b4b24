"""How fast: Penumbra, a textbook loop, Cycles and Mitsuba side by side (`make bench`)."""
