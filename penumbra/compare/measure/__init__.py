"""Images, distances between them, statistics and verdicts."""
