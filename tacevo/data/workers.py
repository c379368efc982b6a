"""Pictures made by several processes at once, which end with the one that started them."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import ModuleType
from typing import Any

from tacevo.sandbox.kernel import end_with

#: Pictures that a worker makes between two reports of progress.
CHUNK = 32

#: Up to this many pictures are made in this process: starting others would take longer. Measured in processor time on
#: an AMD EPYC: a worker takes 0.2 to 0.3 s to start, a picture 4.5 ms drawn at 256 pixels, 1.1 ms drawn at 64, 10 ms
#: decoded from a PNG of 640 x 480; so two workers on two idle cores should win from 140, 400 and 40 pictures. On busy
#: cores, with three times as many processes as cores, two workers had not won at 512.
FEW_PICTURES = 200

#: Called with (pictures made, pictures in all).
Progress = Callable[[int, int], None]


@contextmanager
def mapper(workers: int, pictures: int) -> Iterator[Callable[..., Iterator[Any]]]:
    """Offer `map`: the plain one, or one over fresh processes (spawned, so that they share no state with us).

    Up to `FEW_PICTURES` are made in this process.
    """
    if workers <= 1 or pictures <= FEW_PICTURES:
        yield map
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, initializer=end_with, initargs=(os.getpid(),))

    def submit(*arguments: Any) -> Iterator[Any]:
        resource_tracker.ensure_running()  # else the pool would start it, which unblocks the signal again
        with _interrupted_later():
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # workers inherit it: Ctrl-C is ours alone
            program, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
            try:  # a worker would import the program that started it, which need not have a `__name__ == "__main__"`
                return pool.map(*arguments)  # starts the workers
            finally:
                sys.modules["__main__"] = program
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    try:
        yield submit
    finally:
        pool.shutdown(cancel_futures=True)  # an interrupted search does not wait for the other pictures


@contextmanager
def _interrupted_later() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait for the end of the block: a worker whose start is cut short ends with a traceback.

    To block the signal in this thread is not enough: a thread of NumPy's may take it, and Python then interrupts
    the main thread all the same.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # Python never interrupts another thread
        return
    came: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    handlers = [signal.signal(number, lambda number, frame: came.append(number)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, handlers, strict=True):
            signal.signal(number, handler)
    if came:
        signal.raise_signal(came[0])
