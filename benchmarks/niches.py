"""What bounds and the scale of the Efficiency Ratio make of the same candidates: niches filled, and niches lost.

    python -m benchmarks.niches tests/golden/bundles/*.zip

The trained candidates of each run are put, in their order, into one archive for each combination. A search under
other settings would have had other parents and hence other candidates, so this compares archives, not searches.
"""

import argparse
import functools
import itertools
import math
import statistics
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

from scipy.stats import entropy

from tacevo.bundles.open import opened
from tacevo.choices import Scale
from tacevo.config.compose import compose
from tacevo.evolution.archive import Bounds, Elite, Individual, NetworkArchive, Point, Tessellation, find_centroids
from tacevo.evolution.descriptors import scaled
from tacevo.results.run import RecordedRun, descriptors_of, read_run


@dataclass(frozen=True, slots=True, kw_only=True)
class Filled:
    """What an archive holds after the last candidate."""

    #: Occupied part of the niches, in [0, 1].
    coverage: float
    #: Greatest coverage after any candidate.
    highest: float
    #: Number of equally full niches that would be as uneven as the candidates' are, from 1 to the number of niches.
    effective: float
    #: Sum of all falls in the number of occupied niches; only moving bounds make one.
    lost: int
    #: Part of the candidates in the fullest tenth of the Efficiency Ratio's axis, in [0.1, 1].
    fullest: float


def filled(points: Sequence[Point], fitnesses: Sequence[float], niches: Tessellation, bounds: Bounds | None) -> Filled:
    """Put candidates into an archive in their order.

    Args:
        points: (ArchDiv, EffRatio as its axis has it) of each candidate, at least one.
        fitnesses: their validation losses.
        niches: of the archive.
        bounds: fixed ones; None for bounds that adapt.
    """
    archive = NetworkArchive(bounds=bounds, fixed=bounds is not None)
    occupied = [0]
    for point, fitness in zip(points, fitnesses, strict=True):
        newcomer = Individual(elite=Elite(name=str(len(occupied)), objective=-fitness), point=point)
        archive, _, _ = archive.offer(niches, newcomer)
        occupied.append(len(archive.archive.elites))
    last = archive.bounds or Bounds(low=points[0], high=points[0])
    places = [last.normalise(point) for point in points]
    tenths = Counter(min(int(10 * place[1]), 9) for place in places)
    return Filled(
        coverage=occupied[-1] / niches.niches,
        highest=max(occupied) / niches.niches,
        effective=math.exp(entropy(list(Counter(niches.niches_of(places)).values()))),
        lost=sum(max(before - after, 0) for before, after in itertools.pairwise(occupied)),
        fullest=max(tenths.values()) / len(places),
    )


def rows(files: Sequence[Path]) -> Iterator[str]:
    """Write a Markdown table: a row for each file and combination, with the medians over a sweep's runs."""
    runs = {path.name: list(_runs(path)) for path in files}
    everyone = [candidate for found in runs.values() for run in found for candidate in run.trained]
    default = compose([]).archive
    given = tuple(zip(default.arch_div_bounds, default.eff_ratio_bounds, strict=True))
    yield "| runs | axis | bounds | coverage | highest on the way | effective niches | niches lost | fullest tenth |"
    yield "|---|---|---|---|---|---|---|---|"
    for name, found in runs.items():
        for scale in Scale:
            points = [descriptors_of(candidate, scale) for candidate in everyone]
            low, high = ((arch_div, scaled(eff_ratio, scale)) for arch_div, eff_ratio in given)
            around = Bounds(low=tuple(map(min, *points)), high=tuple(map(max, *points)))
            for rule, bounds in (
                ("adaptive", None),
                ("fixed, the defaults", Bounds(low=low, high=high)),
                ("fixed, around all runs", around),
            ):
                figures = _medians([_filled(run, scale, bounds) for run in found])
                yield f"| {name} ({len(found)}) | {scale.value} | {rule} | {figures} |"


def _runs(path: Path) -> Iterator[RecordedRun]:
    source = opened(path)
    yield from map(read_run, source.runs)


def _filled(run: RecordedRun, scale: Scale, bounds: Bounds | None) -> Filled:
    """Put a run's candidates into the niches of its configuration, also where the run itself kept none."""
    settings = run.config.archive
    niches = _niches(settings.niches, settings.samples, settings.seed)
    fitnesses = [candidate.fitness for candidate in run.trained if candidate.fitness is not None]
    return filled([descriptors_of(candidate, scale) for candidate in run.trained], fitnesses, niches, bounds)


@functools.cache
def _niches(niches: int, samples: int, seed: int) -> Tessellation:
    return Tessellation(find_centroids(niches=niches, dimensions=2, samples=samples, seed=seed))


def _medians(found: Sequence[Filled]) -> str:
    coverage, highest, effective, lost, fullest = map(statistics.median, zip(*map(astuple, found), strict=True))
    return f"{coverage:.0%} | {highest:.0%} | {effective:.1f} | {lost:g} | {fullest:.0%}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="bundle or directory of a run or a sweep")
    for row in rows(parser.parse_args().files):
        print(row, flush=True)


if __name__ == "__main__":
    main()
