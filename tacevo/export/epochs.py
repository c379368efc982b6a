"""Counts the epochs of an export for who waits: those that trainings tell, and by the pace those that none tells."""

import contextlib
import threading
import time
from collections.abc import Iterator

from tacevo.runs.progress import Progress


class EpochCount:
    """Shows how many of all epochs are done.

    A study's training tells each epoch; one that is begun again tells some twice. One whose weights are kept tells none
    before its end; it goes at the pace of the others, or of the search, so its epochs are counted by that. None is
    counted as more epochs than it has.
    """

    def __init__(self, view: Progress, total: int, seconds: float | None) -> None:
        self._view, self._total, self._done = view, total, 0
        #: Seconds of an epoch, of the last training that told its own; None where nothing is known.
        self._seconds = seconds
        self._lock, self._own = threading.Lock(), threading.local()
        view.advance("epochs", 0, total)

    def told(self) -> None:
        """Count an epoch of this thread's training, up to the last that it has."""
        if left := getattr(self._own, "left", 0):
            self._own.left = left - 1
            self._add(1)

    @contextlib.contextmanager
    def telling(self, epochs: int) -> Iterator[None]:
        """Count a training of this thread that tells its epochs; at its end all of them are counted."""
        self._own.left, began = epochs, time.monotonic()
        yield
        self._add(self._own.left)
        self._own.left = 0
        self._seconds = (time.monotonic() - began) / epochs

    @contextlib.contextmanager
    def paced(self, epochs: int) -> Iterator[None]:
        """Count a training that tells nothing, by the pace; at its end all of its epochs are counted."""
        ended, counted, seconds = threading.Event(), 0, self._seconds

        def count() -> None:
            nonlocal counted
            while seconds is not None and counted < epochs - 1 and not ended.wait(seconds):
                counted += 1
                self._add(1)

        thread = threading.Thread(target=count, daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()
        self._add(epochs - counted)

    def _add(self, epochs: int) -> None:
        with self._lock:
            self._done += epochs
            self._view.advance("epochs", self._done, self._total)
