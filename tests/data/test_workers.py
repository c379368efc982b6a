"""Promise: pictures that several processes make end with the process that started them, and only with it."""

import os
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from tacevo.cli.edge import edge
from tacevo.data.workers import FEW_PICTURES, mapper


@pytest.mark.parametrize("signal_", [signal.SIGINT, signal.SIGTERM])
def test_end_that_is_asked_for_waits_until_the_workers_have_started(signal_: signal.Signals) -> None:
    """It comes with the first picture that is handed out; all others are, and then it is raised."""
    given: list[int] = []

    def numbers() -> Iterator[int]:
        os.kill(os.getpid(), signal_)
        for number in range(FEW_PICTURES + 1):
            given.append(number)
            yield number

    with pytest.raises(KeyboardInterrupt), edge(), mapper(2, FEW_PICTURES + 1) as run:
        run(abs, numbers())
    assert len(given) == FEW_PICTURES + 1
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_another_thread_may_ask_for_workers() -> None:
    """On a node of a cluster a thread makes the images; Ctrl-C never comes to it."""

    def make() -> list[int]:
        with mapper(2, FEW_PICTURES + 1) as run:
            return list(run(abs, range(-3, 0)))

    with ThreadPoolExecutor(1) as threads:
        assert threads.submit(make).result() == [3, 2, 1]
