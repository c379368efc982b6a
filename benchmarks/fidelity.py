"""How long should a search train a network? Answered from published studies, whose trainings are 70 epochs long.

    python -m benchmarks.fidelity

Two groups of networks were trained with two seeds each: first mutations, of which nobody had chosen, and the elites of
searches, which had been chosen by trainings of ten epochs. A fitness after so many epochs under one seed is set beside
the test loss after 70 epochs under the other, both ways: Kendall's tau among all networks of a group. Then ways to
spend the same number of epochs are compared on draws from a group: many short trainings, few long ones, or short ones
of which the fittest are trained anew to the end (`choose=validated`). The network that is handed over is judged by the
seed that did not choose.

A block is a job, whose networks share their training seeds; intervals are of blocks. Nothing of it was planned before
the trainings.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kendalltau, t

import tacevo
from analysis.studies.reestimates import losses_of
from tacevo.randomness import stream
from tacevo.storage.sweep_directory import SweepDirectory

#: The published sweeps, by what their networks are.
GROUPS: Mapping[str, str] = {
    "first mutations": "cache/published/first-mutations.zip",
    "elites": "cache/published/ablation-elites.zip",
}

#: Numbers of epochs whose fitness is looked at.
EPOCHS = (1, 3, 5, 10, 20, 30, 50, 70)

#: Epochs that are spent, and ways to do it: epochs of a short training, and how many networks are then trained fully.
SPENT = 350
WAYS = ((70, 0), (20, 0), (10, 0), (20, 3), (10, 3), (5, 3))

DRAWS = 4000


class Block(NamedTuple):
    """The networks of a job but for its baseline: n of them, two seeds."""

    #: The lowest validation loss after each epoch, shape (n, 2, epochs).
    lowest: NDArray[np.float64]
    #: The validation loss after each epoch, in the same shape.
    last: NDArray[np.float64]
    #: The logarithm of the test loss at the end, shape (n, 2).
    ends: NDArray[np.float64]


def blocks_of(place: str) -> list[Block]:
    """Read the studies of a sweep's jobs, of which no training may have failed."""
    sweep, blocks = tacevo.open(place), []
    assert isinstance(sweep, tacevo.Sweep)
    for job in SweepDirectory(sweep.place.folder).read().jobs:
        run = sweep.run(job.name)
        for study in run.studies:
            if study.is_noise or study.is_choice:
                continue
            shape = len(study.networks), study.scores["seed"].nunique()
            rows = study.recorded.scores
            losses = np.array([losses_of(run.recorded.stores, row) for row in rows]).reshape(*shape, -1)[1:]
            tests = np.array([row.metrics["cross_entropy"] for row in rows]).reshape(shape)[1:]
            blocks.append(Block(np.minimum.accumulate(losses, axis=2), losses, np.log(tests)))
    return blocks


def tau(fitness: NDArray[np.float64], ends: NDArray[np.float64]) -> float:
    """Return Kendall's tau of each seed's fitness with the other seed's end, the mean of both; shapes (n, 2)."""
    return float(np.mean([kendalltau(fitness[:, seed], ends[:, 1 - seed]).statistic for seed in (0, 1)]))


def with_interval(
    blocks: Sequence[Block], figures: Callable[[Block], NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return figures of all blocks together, and the ends of their 95 % intervals.

    These are Student's, by the figures of all blocks but one (the jackknife). A bootstrap would draw blocks twice, and
    then the draws of a way would meet a network twice.
    """
    count, whole = len(blocks), figures(joined(blocks))
    without = np.array([figures(joined([*blocks[:row], *blocks[row + 1 :]])) for row in range(count)])
    error = np.sqrt((count - 1) ** 2 / count * without.var(axis=0, ddof=1))
    width = float(t.ppf(0.975, count - 1)) * error
    return whole, whole - width, whole + width


def joined(blocks: Sequence[Block]) -> Block:
    """Lay the networks of several blocks together."""
    return Block(*(np.concatenate(parts) for parts in zip(*blocks, strict=True)))


def taus(block: Block) -> NDArray[np.float64]:
    """Return tau after each number of epochs, of the lowest loss and of the last, shape (epochs, 2)."""
    rows = [[tau(losses[:, :, epochs - 1], block.ends) for losses in (block.lowest, block.last)] for epochs in EPOCHS]
    return np.array(rows)


def handed(block: Block, epochs: int, full: int, rng: np.random.Generator) -> float:
    """Return the mean log test loss of what draws hand over, by the seed that did not choose.

    Args:
        block: the networks to draw from, without replacement.
        epochs: of a short training.
        full: how many of the fittest are trained anew to their end, which then chooses; 0: the fittest is handed over.
        rng: of the draws.
    """
    networks, longest = len(block.ends), block.lowest.shape[2]
    count, found = min(networks, (SPENT - full * longest) // epochs), []
    for draw in range(DRAWS):
        rows, seed = rng.permutation(networks)[:count], draw % 2
        best = rows[np.argsort(block.lowest[rows, seed, epochs - 1], kind="stable")[: max(1, full)]]
        found.append(block.ends[best[block.lowest[best, seed, -1].argmin()], 1 - seed])
    return float(np.mean(found))


def spent(block: Block) -> NDArray[np.float64]:
    """Return the mean log test loss of what each way hands over, and below it less that of the first way."""
    rng = stream(0, "draws")
    means = np.array([handed(block, epochs, full, rng) for epochs, full in WAYS])
    return np.stack([means, means - means[0]])


def main() -> None:
    """Print both tables."""
    groups = {name: blocks_of(place) for name, place in GROUPS.items()}
    print(f"| epochs | {' | '.join(f'{name}: lowest | last' for name in groups)} |")
    print(f"|{'---|' * (1 + 2 * len(groups))}")
    found = [with_interval(blocks, taus) for blocks in groups.values()]
    for row, epochs in enumerate(EPOCHS):
        cells = [
            "{:.2f} [{:.2f}, {:.2f}]".format(*(part[row, rule] for part in one)) for one in found for rule in (0, 1)
        ]
        print(f"| {epochs} | {' | '.join(cells)} |")
    print(f"\n| {SPENT} epochs | {' | '.join(f'{name} | beside the first row' for name in groups)} |")
    print(f"|{'---|' * (1 + 2 * len(groups))}")
    found = [with_interval(blocks, spent) for blocks in groups.values()]
    longest = {blocks[0].lowest.shape[2] for blocks in groups.values()}.pop()
    for row, (epochs, full) in enumerate(WAYS):
        name = f"{(SPENT - full * longest) // epochs} of {epochs}" + (f", then {full} of {longest}" if full else "")
        ratios = [[math.exp(part[kind, row]) for part in one] for one in found for kind in (0, 1)]
        print(f"| {name} | {' | '.join('{:.2f} [{:.2f}, {:.2f}]'.format(*each) for each in ratios)} |")
    for name, blocks in groups.items():
        whole = joined(blocks)
        late = float((whole.last.argmin(axis=2) >= 0.9 * whole.last.shape[2]).mean())
        print(f"{name}: {len(whole.ends)} in {len(blocks)} blocks; {late:.0%} of the trainings best in the last tenth")


if __name__ == "__main__":
    main()
