"""Tests, effect sizes, equivalence and power; pure."""
