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
from tacevo.evolution.reevaluation import Estimates
from tacevo.results.run import RecordedRun


def archive_history(run: RecordedRun, centroids: NDArray[np.float64]) -> tuple[Archive, ...]:
    """Return the elites of the network archive after each generation, in order.

    The centroids, shape (niches, axes), in [0, 1], are not looked at where its archive has no niches.
    """
    niches = Tessellation(centroids) if run.has_niches else TopK(niches=run.places)
    arrivals = iter(descriptors(run).tolist())
    fixed = run.bounds if run.config.archive.bounds is BoundsRule.fixed else None
    archive = NetworkArchive(bounds=fixed, fixed=fixed is not None)
    estimates, archives = Estimates(rule=run.config.training.fitness), []
    for line in run.generations:
        for candidate in run.candidates:
            if candidate.generation == line.generation and candidate.fitness is not None:
                fitness = candidate.fitness
                if run.reevaluations:
                    estimates = estimates.after(candidate)
                    fitness = estimates.fitness(str(candidate.source))
                elite = Elite(name=candidate.id, objective=-fitness)
                archive, _, _ = archive.offer(niches, Individual(elite=elite, point=tuple(next(arrivals))))
        for again in run.reevaluations:
            if again.generation == line.generation:
                estimates = estimates.after(again)
                names = [one.id for one in run.trained if one.source == again.source and one.id in archive.history]
                archive = archive.reestimated(niches, names, -estimates.fitness(str(again.source)))
        archives.append(archive.archive)
    return tuple(archives)


def archive_medians(run: RecordedRun, centroids: NDArray[np.float64]) -> tuple[float | None, ...]:
    """Return the median fitness of the elites after each generation; None before anything was trained."""
    fitnesses = [[-elite.objective for elite in it.elites.values()] for it in archive_history(run, centroids)]
    return tuple(statistics.median(values) if values else None for values in fitnesses)
