"""Full SLAM: the posterior over the whole trajectory, refined when the log has ended."""
