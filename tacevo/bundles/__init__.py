"""Published runs: one zip file each."""
