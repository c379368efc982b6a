"""Runs: the course of a search, its archive and its niches, from its records."""
