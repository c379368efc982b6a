"""What sweeps recorded, and how arms compare."""
