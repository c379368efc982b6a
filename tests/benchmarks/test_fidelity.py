"""Promise: what is said of the length of trainings follows from published studies, and no seed that chose judges."""

import numpy as np
import pytest
from checkout import ROOT

from benchmarks.fidelity import (
    EPOCHS,
    GROUPS,
    Block,
    blocks_of,
    handed,
    joined,
    taus,
    with_interval,
)
from tacevo.randomness import stream

pytestmark = pytest.mark.room("noise")


def _block(networks: int, seed: int) -> Block:
    """Make networks up whose losses after 70 epochs say nothing of each other's."""
    losses = np.random.default_rng(seed).uniform(0.1, 1, (networks, 2, 70))
    lowest = np.minimum.accumulate(losses, axis=2)
    return Block(lowest, losses, np.log(np.random.default_rng(seed + 100).uniform(0.1, 1, (networks, 2))))


def test_interval_of_a_mean_is_students() -> None:
    """With blocks of one size the jackknife gives the usual interval of their means."""
    blocks = [_block(4, seed) for seed in range(6)]
    means = np.array([block.ends.mean() for block in blocks])
    value, low, high = with_interval(blocks, lambda block: np.array([block.ends.mean()]))
    width = 2.5705818 * means.std(ddof=1) / 6**0.5
    assert value == pytest.approx(means.mean())
    assert low == pytest.approx(means.mean() - width)
    assert high == pytest.approx(means.mean() + width)


def test_fitness_is_set_beside_the_other_seed() -> None:
    """A fitness that is its own seed's end says nothing, and one that is the other's says all."""
    block = _block(30, 1)
    for other, expected in ((0, False), (1, True)):
        known = np.exp(block.ends[:, [other, 1 - other]])[:, :, None].repeat(70, axis=2)
        found = taus(Block(known, known, block.ends))
        assert bool((found == 1).all()) is expected
        assert found.shape == (len(EPOCHS), 2)


def test_seed_that_chose_does_not_judge() -> None:
    """The lowest loss of one seed is handed over, and its other seed's end counts; full trainings decide the last."""
    ends = np.log(np.array([[0.9, 0.2], [0.3, 0.8], [0.5, 0.5]]))
    lowest = np.ones((3, 2, 70))
    lowest[0, 0], lowest[1, 1] = 0.1, 0.1
    block = Block(lowest, lowest, ends)
    assert handed(block, 10, 0, stream(0, "a")) == pytest.approx(np.log([0.2, 0.3]).mean())
    late = lowest.copy()
    late[2, :, -1] = 0.01  # what a short training does not show
    assert handed(Block(late, late, ends), 10, 3, stream(0, "a")) == pytest.approx(np.log(0.5))


def test_page_shows_the_figures() -> None:
    """Each row of the table of docs/evidence.md is computed from the bundles."""
    page = (ROOT / "docs/evidence.md").read_text(encoding="utf-8")
    blocks = {name: blocks_of(str(ROOT / place)) for name, place in GROUPS.items()}
    found = [with_interval(each, taus) for each in blocks.values()]
    rows = [
        line for line in page.splitlines() if line.startswith("| ") and line.count(" [") == 4 and " of " not in line
    ]
    assert len(rows) > 3
    for line in rows:
        row = EPOCHS.index(int(line.split("|")[1]))
        cells = [
            "{:.2f} [{:.2f}, {:.2f}]".format(*(part[row, rule] for part in one)) for one in found for rule in (0, 1)
        ]
        assert line == f"| {EPOCHS[row]} | {' | '.join(cells)} |"
    assert [len(joined(each).ends) for each in blocks.values()] == [40, 80]
