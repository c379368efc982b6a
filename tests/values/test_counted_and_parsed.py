"""Text: nouns that follow their number, and source that several threads parse."""

import gc
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from tacevo.text import counted, parse_python


@pytest.mark.parametrize(("number", "words"), [(0, "0 answers"), (1, "1 answer"), (2, "2 answers"), (11, "11 answers")])
def test_noun_follows_its_number(number: int, words: str) -> None:
    """Only one is singular."""
    assert counted(number, "answer") == words


@pytest.mark.slow
def test_threads_may_parse_at_once() -> None:
    """CPython 3.11 counts the depth of its parser for all threads, and fails where they switch within it."""
    source = "\n".join(f"def f{number}(x): return [x + {number}, (x,), {{x: [x]}}]" for number in range(200))
    interval, thresholds = sys.getswitchinterval(), gc.get_threshold()

    def pause(phase: str, info: dict[str, int]) -> None:
        """Let another thread in, in the middle of a parse."""
        time.sleep(0.0001)

    gc.callbacks.append(pause)
    gc.set_threshold(50)
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as executor:
            assert len(list(executor.map(parse_python, [source] * 60))) == 60
    finally:
        sys.setswitchinterval(interval)
        gc.set_threshold(*thresholds)
        gc.callbacks.remove(pause)
