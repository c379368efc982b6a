"""Promise: what is said of the length of trainings follows from published studies, and no seed that chose judges."""

import numpy as np
import pytest
from checkout import ROOT

from benchmarks.fidelity import (
    EPOCHS,
    GROUPS,
    SPENT,
    Block,
    blocks_of,
    drawn,
    handed_over,
    joined,
    table_lines,
    taus,
    with_interval,
)

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
    """A fitness that is its own seed's test loss says nothing, and one that is the other's says all."""
    block = _block(30, 1)
    for other, expected in ((0, False), (1, True)):
        known = np.exp(block.ends[:, [other, 1 - other]])[:, :, None].repeat(70, axis=2)
        found = taus(Block(known, known, block.ends))
        assert bool((found == 1).all()) is expected
        assert found.shape == (len(EPOCHS), 2)


def test_seed_that_chose_does_not_judge() -> None:
    """By hand, of 21 networks of which all are drawn: the fittest by a seed, judged by the other."""
    ends = np.zeros((21, 2))
    ends[0], ends[1] = (-9.0, 0.2), (0.3, -9.0)
    lowest = np.ones((21, 2, 70))
    lowest[0, 0], lowest[1, 1] = 0.1, 0.1
    assert handed_over(Block(lowest, lowest, ends), 10, 0) == pytest.approx((0.2 + 0.3) / 2)


@pytest.mark.parametrize(("epochs", "promoted"), [(70, 0), (20, 0), (20, 2), (10, 2)])
def test_expected_draws_are_what_draws_give(epochs: int, promoted: int) -> None:
    """A simulation of the same way agrees within its error, and spends no more epochs."""
    block, rng, found = _block(14, 3), np.random.default_rng(0), []
    count = drawn(epochs, promoted, 70)
    assert count * epochs + promoted * (70 - epochs) <= SPENT
    for draw in range(6000):
        rows, seed = rng.permutation(14)[:count], draw % 2
        best = rows[np.argsort(block.lowest[rows, seed, epochs - 1])[: max(1, promoted)]]
        last = block.lowest[best, seed, -1 if promoted else epochs - 1]
        found.append(block.ends[best[last.argmin()], 1 - seed])
    assert handed_over(block, epochs, promoted) == pytest.approx(np.mean(found), abs=4 * np.std(found) / 6000**0.5)


def test_page_shows_the_figures() -> None:
    """Each row of the tables of docs/evidence.md is computed from the bundles; a network counts once."""
    blocks = {name: blocks_of(str(ROOT / place)) for name, place in GROUPS.items()}
    assert "\n".join(table_lines(blocks)[:10]) in (page := (ROOT / "docs/evidence.md").read_text(encoding="utf-8"))
    assert all(line in page for line in table_lines(blocks))
    assert {name: (len(each), len(joined(each).ends)) for name, each in blocks.items()} == {
        "first mutations": (8, 40),
        "elites": (8, 79),
    }
