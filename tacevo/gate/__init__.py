"""The gate, from a model's raw answer to an admitted candidate: extraction, static policy, probe."""
