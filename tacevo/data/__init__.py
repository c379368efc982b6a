"""Data sets: the protocol every task follows, a simulated sensor, and loaders for real recordings."""
