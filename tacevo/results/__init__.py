"""Finished runs, studies and sweeps, read and checked once: for commands, API, bundles and analysis."""
