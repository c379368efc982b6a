"""Runs, studies and sweeps from Python; the commands print what is made here."""
