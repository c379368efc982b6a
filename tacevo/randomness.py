"""Named random streams: randomness has a name, not a position."""

import hashlib
import json

import numpy as np


def stream(seed: int, *name: str | int) -> np.random.Generator:
    """Make the generator of one named purpose, e.g. `stream(0, "parents", generation, slot)`.

    It follows from the run's seed and its name alone and is never stored or shared. So a resumed, reordered or parallel
    run draws the same numbers, and a draw that is left out changes no other. Philox is counter-based, and its integers
    are equal on every CPU.
    """
    return np.random.Generator(np.random.Philox(key=_key(seed, name)))


def derived_seed(seed: int, *name: str | int) -> int:
    """Derive a seed in [0, 2**63) for a library that wants a number, such as `torch.manual_seed`."""
    return _key(seed, name) % 2**63


def _key(seed: int, name: tuple[str | int, ...]) -> int:
    """Hash a stream's name to the 128 bits that Philox takes as its key."""
    digest = hashlib.sha256(json.dumps([seed, *name]).encode()).digest()
    return int.from_bytes(digest[:16], "big")
