"""Studies: their networks, compared."""
