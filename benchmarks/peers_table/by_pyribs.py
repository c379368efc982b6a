"""pyribs: MAP-Elites over genes as numbers from 0 to 1, with niches by depth and width."""

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray
from ribs.archives import GridArchive
from ribs.emitters import GaussianEmitter
from ribs.schedulers import Scheduler

from benchmarks.peers_table.asking import Choices, Genes

#: The genes whose values are the niches: they decide a network's size, and are known without training.
NICHES = ("depth", "width")

#: Standard deviation of a mutation: a gene of two choices, whose border is at 0.5, often changes.
SIGMA = 0.3

#: Networks of a generation; the first one is drawn at random.
BATCH = 5


def map_elites(choices: Choices, seed: int, trainings: int) -> Generator[Genes, float, None]:
    """Mutate elites that are drawn from the archive."""
    names = list(choices)
    axes = [names.index(name) for name in NICHES]
    dims = [len(choices[name]) for name in NICHES]
    first = np.random.default_rng(seed).random((BATCH, len(names)))
    archive = GridArchive(solution_dim=len(names), dims=dims, ranges=[(0, 1)] * len(dims), seed=seed)
    emitter = GaussianEmitter(
        archive,
        sigma=SIGMA,
        initial_solutions=first,
        lower_bounds=[0.0] * len(names),
        upper_bounds=[1.0] * len(names),
        batch_size=BATCH,
        seed=seed,
    )
    scheduler = Scheduler(archive, [emitter])
    while True:
        points = scheduler.ask()
        fitness = []
        for point in points:
            fitness.append((yield _genes(choices, point)))
        scheduler.tell([-value for value in fitness], points[:, axes])


def _genes(choices: Choices, point: NDArray[np.float64]) -> Genes:
    """Take, for each gene, the choice in whose equal part of [0, 1] its number lies."""
    parts = zip(choices.items(), point, strict=True)
    return {name: values[min(int(part * len(values)), len(values) - 1)] for (name, values), part in parts}
