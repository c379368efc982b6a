"""One run from its configuration to its directory: the one place that builds objects."""
