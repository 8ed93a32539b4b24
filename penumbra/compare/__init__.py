"""Error and convergence of rendered soft shadows: metrics, statistics and the exact answer."""
