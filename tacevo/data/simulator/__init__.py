"""A simulated sensor."""
