"""Algorithm 1 and its pure core."""
