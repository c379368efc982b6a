"""The nodes of a Ray cluster as the search sees them: confined processes, elsewhere."""
