"""What networks have in common, read from what they do."""
