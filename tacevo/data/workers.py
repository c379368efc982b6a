"""Pictures made by several threads at once: NumPy and Pillow do their work outside Python's lock."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

#: Pictures that a thread makes between two reports of progress.
CHUNK = 32

#: Called with (pictures made, pictures in all).
Progress = Callable[[int, int], None]


def each(make: Callable[[int], None], count: int, workers: int, progress: Progress | None) -> None:
    """Call a function with every number below a count, in so many threads; `progress` is called after every chunk."""

    def make_chunk(start: int) -> int:
        end = min(start + CHUNK, count)
        for number in range(start, end):
            make(number)
        return end

    threads = ThreadPoolExecutor(workers)
    try:
        for done in threads.map(make_chunk, range(0, count, CHUNK)):
            if progress is not None:
                progress(done, count)
    finally:
        threads.shutdown(cancel_futures=True)  # an interrupted search does not wait for the other pictures
