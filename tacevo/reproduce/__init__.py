"""Replay, retrain, compare and export runs."""
