"""The network archive after each generation, computed by replaying the insertions of a ledger.

A line of the ledger names the niche that a candidate had when it came. Where bounds move later, niches change and the
archive is rebuilt, so the elites of an earlier generation follow from the candidates only. A run that may not be
finished is read in this way: as far as its whole generations go, as if it had been that many generations long.
"""

import statistics
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.runs.coverage_map import descriptors
from analysis.runs.niches import Niches, load_niches
from tacevo.choices import BoundsRule
from tacevo.evolution.archive import AddStatus, Archive, Elite, Individual, NetworkArchive, Tessellation, TopK
from tacevo.evolution.lines import GenerationLine
from tacevo.evolution.run_files import EliteEntry, TrialEntry, read_ledger
from tacevo.results.run import RecordedRun, without_archives
from tacevo.storage.ledger import Sealed
from tacevo.storage.run_directory import RunDirectory


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


def load_begun(path: Path, store: Path | None = None) -> tuple[RecordedRun, Niches] | None:
    """Read a run and its niches; None before its first generation has ended.

    Its digest is that of a run of so many generations. Both archives follow from the ledger, because their files may be
    older or newer than the lines that were read. `store` is where its stores lie, if not where the run has them.

    Raises:
        RunError: run.json is missing, or something of the run was damaged or edited.
        StoreError: the store's entry of its niches is damaged.
    """
    directory = RunDirectory(path)
    record, ledger = directory.read_run(), read_ledger(directory)
    ends = [number for number, line in enumerate(ledger.lines, start=1) if isinstance(line, GenerationLine)]
    if not ends:
        return None
    whole = Sealed(ledger.lines[: ends[-1]], ledger.hashes[: ends[-1]])
    run = without_archives(directory, record, whole, None if store is None else str(store))
    niches = load_niches(run)
    return replace(run, elites=_elites(run, niches), prompt_trials=_trials(run, niches)), niches


def _elites(run: RecordedRun, niches: Niches) -> tuple[EliteEntry, ...]:
    """Return the elites of the network archive after the last generation, niche by niche."""
    held = archive_history(run, niches.networks)[-1].elites
    points = dict(zip((line.id for line in run.trained), descriptors(run).tolist(), strict=True))
    return tuple(
        EliteEntry(
            niche=niche,
            centroid=tuple(niches.networks[niche].tolist()) if run.has_niches else None,
            id=elite.name,
            fitness=-elite.objective,
            descriptors=tuple(points[elite.name]),
        )
        for niche, elite in sorted(held.items())
    )


def _trials(run: RecordedRun, niches: Niches) -> tuple[TrialEntry, ...]:
    """Return the occupants of the prompt archive: in each niche the last one that was let in."""
    temperatures = {line.generation: line.temperature for line in run.generations}
    trials = {}
    for line in run.candidates:
        let_in = line.prompt_status in {AddStatus.new, AddStatus.improved}
        if let_in and line.prompt is not None and line.prompt_niche is not None and line.curiosity is not None:
            trials[line.prompt_niche] = TrialEntry(
                niche=line.prompt_niche,
                centroid=tuple(niches.prompts[line.prompt_niche].tolist()),
                id=line.id,
                instruction=run.instructions[line.prompt],
                prompt=line.prompt,
                temperature=temperatures[line.generation],
                inserted=line.inserted,
                curiosity=line.curiosity,
            )
    return tuple(trials[niche] for niche in sorted(trials))
