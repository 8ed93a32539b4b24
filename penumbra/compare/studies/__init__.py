"""What is measured over many renders: convergence, trade, stability, self-shadowing, speed-up."""
