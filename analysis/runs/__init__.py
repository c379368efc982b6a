"""What runs recorded, and how a search went."""
