"""Waiting for what must happen soon, without asserting how soon."""

import time
from collections.abc import Callable


def eventually(condition: Callable[[], bool]) -> bool:
    """Wait until a condition holds, at most 10 seconds."""
    deadline = time.monotonic() + 10
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True
