"""The mirror: a separate process that shows a run's ledger in MLflow."""
