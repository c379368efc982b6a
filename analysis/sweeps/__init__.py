"""Sweeps: their arms, compared; their pilots and plans."""
