"""How long should a search train a network? Answered from published studies, whose trainings are 70 epochs long.

    python -m benchmarks.fidelity

Two groups of networks were trained with two seeds each: first mutations, of which nobody had chosen, and the elites of
searches, which had been chosen by trainings of ten epochs. A fitness after so many epochs under one seed is set beside
the test loss after 70 epochs under the other, both ways: Kendall's tau among all networks of a group. Then ways to
spend the same number of epochs are compared on draws from a group: long trainings of few networks, short ones of many,
or short ones of which the best are trained on. The network that is handed over is judged by the seed that did not
choose; what draws hand over is expected exactly, without a simulation.

A block is a seed of the searches: its jobs share their training seeds. Intervals are Student's, by the figures of all
blocks but one (the jackknife). Nothing of it was planned before the trainings.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kendalltau, t

import tacevo
from analysis.studies.reestimates import losses_of
from benchmarks.handed_over import studied
from benchmarks.written import interval
from tacevo.results.study_lines import ScoreLine

#: The published sweeps, by what their networks are.
GROUPS: Mapping[str, str] = {
    "first mutations": "cache/published/first-mutations.zip",
    "elites": "cache/published/ablation-elites.zip",
}

#: Numbers of epochs whose fitness is looked at, and pairs of them that are compared.
EPOCHS = (1, 3, 5, 10, 20, 30, 50, 70)
PAIRS = ((5, 50), (5, 70), (10, 70))

#: Epochs that are spent, and ways to do it: epochs of a training, and how many of the best are then trained on.
SPENT = 210
WAYS = ((70, 0), (20, 0), (10, 0), (20, 2), (10, 2), (5, 2))


class Block(NamedTuple):
    """Different networks of the searches of a seed, but for the baseline: n of them, two training seeds."""

    #: The lowest validation loss after each epoch, shape (n, 2, epochs).
    lowest: NDArray[np.float64]
    #: The validation loss after each epoch, in the same shape.
    last: NDArray[np.float64]
    #: The logarithm of the test loss at the end, shape (n, 2).
    ends: NDArray[np.float64]


class Estimate(NamedTuple):
    """Figures of any one shape, and the ends of their intervals."""

    value: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def blocks_of(place: str) -> list[Block]:
    """Read the studies of a sweep; a network that two jobs trained with the same seeds counts once.

    Raises:
        ValueError: a training failed.
    """
    sweep, found = tacevo.open(place), dict[int, dict[tuple[str, ...], Block]]()
    assert isinstance(sweep, tacevo.Sweep)
    for job, run, study in studied(sweep):
        trained: dict[str, list[ScoreLine]] = {}
        for row in study.recorded.scores:
            trained.setdefault(row.network, []).append(row)
        for name, rows in trained.items():
            if len(rows) != study.scores["seed"].nunique():
                raise ValueError(f"{place}, {job.name}: a training of {name} failed; expected none that did")
            if name != "baseline":
                losses = np.array([[losses_of(run.recorded.stores, row) for row in rows]])
                ends = np.log([[row.metrics["cross_entropy"] for row in rows]])
                known = tuple(row.evaluation for row in rows)
                found.setdefault(job.seed, {})[known] = Block(np.minimum.accumulate(losses, axis=2), losses, ends)
    return [joined([*networks.values()]) for networks in found.values()]


def joined(blocks: Sequence[Block]) -> Block:
    """Lay the networks of several blocks together."""
    return Block(*(np.concatenate(parts) for parts in zip(*blocks, strict=True)))


def with_interval(blocks: Sequence[Block], figures: Callable[[Block], NDArray[np.float64]]) -> Estimate:
    """Return figures of all blocks together, with their intervals of 95 % by the jackknife."""
    count, whole = len(blocks), figures(joined(blocks))
    without = np.array([figures(joined([*blocks[:row], *blocks[row + 1 :]])) for row in range(count)])
    width = float(t.ppf(0.975, count - 1)) * (count - 1) / count**0.5 * without.std(axis=0, ddof=1)
    return Estimate(whole, whole - width, whole + width)


def taus(block: Block) -> NDArray[np.float64]:
    """Return Kendall's tau of each seed's fitness with the other seed's test loss, the mean of both.

    Returns:
        Shape (epochs, 2): after each number of epochs, of the lowest loss and of the last.
    """
    found = [
        [
            np.mean([kendalltau(losses[:, seed, epochs - 1], block.ends[:, 1 - seed]).statistic for seed in (0, 1)])
            for losses in (block.lowest, block.last)
        ]
        for epochs in EPOCHS
    ]
    return np.array(found)


def gains(block: Block) -> NDArray[np.float64]:
    """Return by how much tau of the lowest loss grows from the first to the second number of epochs of each pair."""
    lowest = dict(zip(EPOCHS, taus(block)[:, 0], strict=True))
    return np.array([lowest[many] - lowest[few] for few, many in PAIRS])


def drawn(epochs: int, promoted: int, longest: int) -> int:
    """Return how many networks a way can draw: it trains each for `epochs`, and the best few of them to the end."""
    return (SPENT - promoted * (longest - epochs)) // epochs


def handed_over(block: Block, epochs: int, promoted: int) -> float:
    """Return the expected log test loss of what draws without replacement hand over, by the seed that did not choose.

    Of networks in the order of their short training, the best k of n drawn are any k of them if the other n - k are
    drawn from those behind; the mean is over all choices of k, each with its chance.
    """
    networks, kept = len(block.ends), max(1, promoted)
    count, found = drawn(epochs, promoted, block.lowest.shape[2]), []
    for seed in (0, 1):
        order = np.argsort(block.lowest[:, seed, epochs - 1], kind="stable")
        final, ends = block.lowest[order, seed, -1], block.ends[order, 1 - seed]
        for best in combinations(range(networks), kept):
            chance = comb(networks - 1 - best[-1], count - kept) / comb(networks, count)
            if chance:
                winner = min(best, key=lambda row: final[row]) if promoted else best[0]
                found.append(chance * ends[winner])
    return float(sum(found)) / 2


def worth(block: Block) -> NDArray[np.float64]:
    """Return the expected log test loss of what each way hands over, less that of the first way."""
    means = np.array([handed_over(block, epochs, promoted) for epochs, promoted in WAYS])
    return np.asarray(means - means[0])


def table_lines(groups: Mapping[str, Sequence[Block]]) -> list[str]:
    """Lay out tau by epochs, its gains, and the ways to spend epochs."""
    found = [with_interval(blocks, taus) for blocks in groups.values()]
    lines = [f"| epochs | {' | '.join(f'{name}, `lowest` | `last`' for name in groups)} |", f"|{'---|' * 5}"]
    for row, epochs in enumerate(EPOCHS):
        cells = [interval(*(part[row, rule] for part in one)) for one in found for rule in (0, 1)]
        lines.append(f"| {epochs} | {' | '.join(cells)} |")
    found = [with_interval(blocks, gains) for blocks in groups.values()]
    lines += ["", f"| tau of `lowest` | {' | '.join(groups)} |", "|---|---|---|"]
    for row, (few, many) in enumerate(PAIRS):
        cells = [interval(*(part[row] for part in one)) for one in found]
        lines.append(f"| after {many} epochs, less that after {few} | {' | '.join(cells)} |")
    longest = {blocks[0].lowest.shape[2] for blocks in groups.values()}.pop()
    found = [with_interval(blocks, worth) for blocks in groups.values()]
    lines += ["", f"| {SPENT} epochs | {' | '.join(groups)} |", "|---|---|---|"]
    for row, (epochs, promoted) in enumerate(WAYS):
        name = f"{drawn(epochs, promoted, longest)} trainings of {epochs} epochs"
        name += f", the best {promoted} of them on to {longest}" if promoted else ""
        cells = [interval(*np.exp([part[row] for part in one]).tolist()) for one in found]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def main() -> None:
    """Print the tables, and of how many networks they are."""
    groups = {name: blocks_of(place) for name, place in GROUPS.items()}
    print("\n".join(table_lines(groups)))
    for name, blocks in groups.items():
        whole = joined(blocks)
        late = float((whole.last.argmin(axis=2) >= 0.9 * whole.last.shape[2]).mean())
        print(f"{name}: {len(whole.ends)} networks of {len(blocks)} seeds; {late:.0%} best in the last tenth")


if __name__ == "__main__":
    main()
