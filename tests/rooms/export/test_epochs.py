"""Promise: who waits for an export reads how many of its epochs are done, and never more than there are."""

import io

import pytest
from rich.console import Console
from waiting import eventually

from tacevo.export.epochs import EpochCount
from tacevo.runs.progress import Progress


class Shown(Progress):
    """Keeps what is shown."""

    def __init__(self) -> None:
        super().__init__(Console(file=io.StringIO()))
        self.counts: list[tuple[int, int]] = []

    def advance(self, what: str, done: int, total: int, note: str = "", *, recalled: bool = False) -> None:
        """Keep it."""
        assert what == "epochs"
        self.counts.append((done, total))


@pytest.mark.parametrize("told", [0, 3, 5, 9])
def test_training_that_tells_its_epochs_is_whole_at_its_end(told: int) -> None:
    """Each as it comes; one that told fewer, or was begun again and told more, counts as often as it has epochs."""
    view = Shown()
    count = EpochCount(view, 5, None)
    with count.telling(5):
        for _ in range(told):
            count.told()
        assert [done for done, _ in view.counts] == [*range(min(told, 5) + 1)]
    assert view.counts[-1] == (5, 5)
    count.told()  # of no training
    assert max(done for done, _ in view.counts) == 5


@pytest.mark.parametrize("seconds", [None, 0.001, 1000.0])
def test_training_that_tells_nothing_goes_by_the_pace(seconds: float | None) -> None:
    """Up to the last epoch, which its end alone tells; without a pace, or with a slow one, its end tells all."""
    view = Shown()
    count = EpochCount(view, 5, seconds)
    with count.paced(5):
        if seconds == 0.001:
            assert eventually(lambda: view.counts[-1] == (4, 5), seconds=20)
        assert view.counts[-1][0] < 5
    assert view.counts[-1] == (5, 5)
