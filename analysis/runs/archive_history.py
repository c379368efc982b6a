"""The network archive after each generation, computed by replaying the insertions of a ledger.

A line of the ledger names the niche that a candidate had when it came. Where bounds move later, niches change and the
archive is rebuilt, so the elites of an earlier generation follow from the candidates only.
"""

import statistics

import numpy as np
from numpy.typing import NDArray

from analysis.runs.coverage_map import descriptors
from tacevo.choices import BoundsRule
from tacevo.evolution.archive import Archive, Elite, Individual, NetworkArchive, Tessellation, TopK
from tacevo.results.run import RecordedRun


def archive_history(run: RecordedRun, centroids: NDArray[np.float64]) -> tuple[Archive, ...]:
    """Return the elites of the network archive after each generation, in order.

    The centroids, shape (niches, axes), in [0, 1], are not looked at where its archive has no niches.
    """
    niches = Tessellation(centroids) if run.has_niches else TopK(niches=run.places)
    arrivals = iter(descriptors(run).tolist())
    fixed = run.bounds if run.config.archive.bounds is BoundsRule.fixed else None
    archive = NetworkArchive(bounds=fixed, fixed=fixed is not None)
    archives = []
    for line in run.generations:
        for candidate in run.candidates:
            if candidate.generation == line.generation and candidate.fitness is not None:
                elite = Elite(name=candidate.id, objective=-candidate.fitness)
                archive, _, _ = archive.offer(niches, Individual(elite=elite, point=tuple(next(arrivals))))
        archives.append(archive.archive)
    return tuple(archives)


def archive_medians(run: RecordedRun, centroids: NDArray[np.float64]) -> tuple[float | None, ...]:
    """Return the median fitness of the elites after each generation; None before anything was trained."""
    fitnesses = [[-elite.objective for elite in it.elites.values()] for it in archive_history(run, centroids)]
    return tuple(statistics.median(values) if values else None for values in fitnesses)
