"""Replay, retrain and compare runs; write what they need into one file."""
