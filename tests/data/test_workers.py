"""Promise: every picture is made once, whatever the threads; an end that is asked for does not wait for all of them."""

import time

import pytest

from tacevo.data.workers import CHUNK, each


@pytest.mark.parametrize("workers", [1, 3])
@pytest.mark.parametrize("count", [0, 1, CHUNK, 3 * CHUNK + 5])
def test_every_number_is_called_once_and_progress_ends_with_all(workers: int, count: int) -> None:
    """Progress is told after every chunk, in order."""
    made: list[int] = []
    told: list[tuple[int, int]] = []
    each(made.append, count, workers, lambda *numbers: told.append(numbers))
    assert sorted(made) == list(range(count))
    assert told == [(min(start + CHUNK, count), count) for start in range(0, count, CHUNK)]


def test_who_stops_waits_for_no_other_chunk() -> None:
    """Ctrl-C comes to the thread that waits."""
    made: list[int] = []

    def make(number: int) -> None:
        time.sleep(0.001)
        made.append(number)

    def stop(done: int, count: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        each(make, 100 * CHUNK, 2, stop)
    assert len(made) < 50 * CHUNK
