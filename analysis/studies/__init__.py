"""What studies recorded, and how networks compare."""
