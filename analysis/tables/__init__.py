"""Tables as records, and how they are written."""
