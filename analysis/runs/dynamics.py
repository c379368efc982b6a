"""How a search went, generation by generation: figures from its ledger, and nothing but counting.

A rate counts first answers, as the paper does: one that was rejected and then repaired counts as rejected.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise

from scipy.stats import binomtest

from analysis.runs.run import Run
from tacevo.costs import Spending, total
from tacevo.evolution.archive import AddStatus
from tacevo.evolution.lines import CandidateLine, GenerationLine, trained_networks, training_flops
from tacevo.records import Operator, Stage
from tacevo.rounding import DIGITS

#: Confidence of every interval here.
LEVEL = 0.95

#: The part of the whole improvement that counts as most of it.
MOST = 0.9

#: By when the paper had most of its improvement (within the first 7 to 10 generations).
PUBLISHED_GENERATIONS = (7, 10)

#: Bands of equal width over the temperatures [0, 1]; one is as wide as the noise of a request's temperature is on
#: either side (docs/paper.md).
BANDS = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class GenerationFigures:
    """One generation."""

    #: What its ledger line says: temperature, best, median, coverage, QD-score.
    line: GenerationLine
    #: Occupied niches, or places, after it.
    elites: int
    #: How many more these are than before it; negative where moved bounds made niches fall together.
    growth: int
    #: Candidates that found their niche empty, and those that beat its elite.
    new: int
    improved: int
    #: First answers that were rejected, by stage; every stage has an entry.
    rejected: Mapping[Stage, int]
    #: Slots whose evaluation was asked for by an earlier slot of this or an earlier generation.
    repeated: int
    #: Slots whose source is that of a parent, to the letter.
    unchanged: int
    #: What its answers cost; None unless that is known of every answer.
    spent: Spending | None

    @property
    def lost(self) -> int:
        """How many occupied niches were empty after bounds moved, less those that were occupied then."""
        return self.new - self.growth


@dataclass(frozen=True, slots=True, kw_only=True)
class Productivity:
    """What came of the mutations that have something in common: their instruction, or their temperature."""

    name: str
    #: Slots that were asked; a child that the gate rejected was tried, too, and inserted nowhere.
    tried: int
    trained: int
    #: Children that the network archive took: the sum of the paper's r(s).
    inserted: int
    #: Wilson's interval of inserted / tried; None where nothing was tried.
    interval: tuple[float, float] | None

    @property
    def rate(self) -> float | None:
        """Inserted / tried, in [0, 1]."""
        return self.inserted / self.tried if self.tried else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Improvement:
    """How far a run came; fitness is a loss, so improvement is the part of it that is gone."""

    baseline: float
    #: Best of generation 0, as the search knew it at its end.
    first: float
    #: Best of the last generation.
    last: float
    #: (first - last) / first and (baseline - last) / baseline; 0 where the reference is 0 already.
    over_first: float
    over_baseline: float
    #: First generation from which on it had `MOST` of the whole improvement over `first`; None without any improvement.
    settled: int | None
    #: Part of the whole improvement that each of `PUBLISHED_GENERATIONS` brought, as far as the run reached it.
    by_generation: tuple[tuple[int, float], ...]
    #: Mean of the trainable share over generations 1 to G; None where there is generation 0 only.
    trainable: float | None
    #: Occupied part of the niches at the end.
    coverage: float


def progress(run: Run) -> tuple[GenerationFigures, ...]:
    """Return the figures of every generation, in order."""
    repeated, unchanged = repeats(run), copies(run)
    found: list[GenerationFigures] = []
    for line in run.generations:
        slots = [candidate for candidate in run.candidates if candidate.generation == line.generation]
        elites = round(line.coverage * run.places)
        statuses = Counter(candidate.status for candidate in slots)
        stages = Counter(first[0] for slot in slots if (first := slot.first_rejection))
        found.append(
            GenerationFigures(
                line=line,
                elites=elites,
                growth=elites - (found[-1].elites if found else 0),
                new=statuses[AddStatus.new],
                improved=statuses[AddStatus.improved],
                rejected={stage: stages[stage] for stage in Stage},
                repeated=sum(candidate.id in repeated for candidate in slots),
                unchanged=sum(candidate.id in unchanged for candidate in slots),
                spent=spending(run, slots),
            )
        )
    return tuple(found)


def repeats(run: Run) -> frozenset[str]:
    """Find the candidates whose evaluation an earlier slot had asked for, by id."""
    seen: set[str] = set()
    found: set[str] = set()
    for candidate in run.candidates:
        if candidate.evaluation in seen:
            found.add(candidate.id)
        if candidate.evaluation is not None:
            seen.add(candidate.evaluation)
    return frozenset(found)


def copies(run: Run) -> frozenset[str]:
    """Find the candidates whose source equals that of one of their parents, by id."""
    sources = {candidate.id: candidate.source for candidate in run.candidates}
    return frozenset(
        candidate.id
        for candidate in run.candidates
        if candidate.source is not None and candidate.source in {sources.get(parent) for parent in candidate.parents}
    )


def by_prompt(run: Run) -> tuple[Productivity, ...]:
    """Return the productivity of every instruction of the library, tried or not, in the library's order."""
    asked = _mutations(run)
    return tuple(
        _productivity(name, [candidate for candidate in asked if candidate.prompt == index])
        for index, name in enumerate(run.instructions)
    )


def by_temperature(run: Run) -> tuple[Productivity, ...]:
    """Return the productivity of every band of the requests' temperatures in which something was asked, rising."""
    bands: dict[int, list[CandidateLine]] = {}
    for candidate in _mutations(run):
        temperature = candidate.sent_temperature
        if temperature is not None:
            band = min(int(temperature * BANDS), BANDS - 1)  # the last band holds its upper end
            bands.setdefault(band, []).append(candidate)
    return tuple(_productivity(f"{band / BANDS:.1f}-{(band + 1) / BANDS:.1f}", bands[band]) for band in sorted(bands))


def temperature_follows_age(run: Run) -> bool:
    """Return whether T is a strictly monotone function of the generation, so that their effects cannot be separated.

    Generations that stand at a limit of 0 or 1, beyond which T cannot move, do not count against it.
    """
    temperatures = [line.temperature for line in run.generations if line.generation > 0]
    steps = [after - before for before, after in pairwise(temperatures) if after != before or after not in {0, 1}]
    return bool(steps) and (min(steps) > 0 or max(steps) < 0)


def improvement(run: Run) -> Improvement | None:
    """Measure how far a run came; None where it lacks a trained baseline, as a fold of a search never does."""
    bests = [(line.generation, line.best) for line in run.generations if line.best is not None]
    known = run.fitness
    baseline = known.get(run.baseline.id)
    if baseline is None or not bests:
        return None
    first, last = bests[0][1], bests[-1][1]
    if run.reevaluations:  # the best that was recorded when generation 0 closed was one draw; this is known at the end
        first = min(known[line.id] for line in run.candidates if line.generation == 0 and line.id in known)
    gained = {generation: (first - best) / (first - last) for generation, best in bests if first > last}
    # Where elites are trained again, the best may rise: what counts is from when on it stayed.
    before = max((generation for generation, share in gained.items() if share < MOST), default=-1)
    later = [line for line in run.generations if line.generation > 0]
    return Improvement(
        baseline=baseline,
        first=first,
        last=last,
        over_first=(first - last) / first if first else 0.0,
        over_baseline=(baseline - last) / baseline if baseline else 0.0,
        settled=next((generation for generation in gained if generation > before), None),
        by_generation=tuple((number, gained[number]) for number in PUBLISHED_GENERATIONS if number in gained),
        trainable=sum(line.trained / line.candidates for line in later) / len(later) if later else None,
        coverage=run.generations[-1].coverage,
    )


def _mutations(run: Run) -> list[CandidateLine]:
    """Return the mutations that count for a prompt: not those of generation 0, which fill an empty archive."""
    return [
        candidate
        for candidate in run.candidates
        if candidate.operator is Operator.mutation and candidate.generation > 0 and candidate.prompt is not None
    ]


def _productivity(name: str, asked: list[CandidateLine]) -> Productivity:
    inserted = sum(candidate.inserted for candidate in asked)
    return Productivity(
        name=name,
        tried=len(asked),
        trained=sum(candidate.fitness is not None for candidate in asked),
        inserted=inserted,
        interval=_wilson(inserted, len(asked)) if asked else None,
    )


def _wilson(found: int, tried: int) -> tuple[float, float]:
    """Return the ends of Wilson's (1927) score interval of found / tried."""
    ends = binomtest(found, tried).proportion_ci(LEVEL, method="wilson")
    return round(float(ends.low), DIGITS), round(float(ends.high), DIGITS)


def spent_on_training(run: Run) -> int:
    """Return the FLOPs of a search's trainings, as its budget counts them, and of its further trainings."""
    trained = trained_networks(run.trained)
    flops = dict(trained)
    again = [line for line in run.reevaluations if line.fitness is not None]
    trained += [(f"{line.source} with seed {line.seed}", flops[str(line.source)]) for line in again]
    images, epochs = run.facts.counts[0], run.config.training.epochs
    return training_flops(trained, images=images, epochs=epochs, seeds=run.seeds)


def spending(run: Run, slots: Iterable[CandidateLine]) -> Spending | None:
    """Add up what the answers of some slots cost; None where one is unknown, because a sum with gaps would mislead."""
    asked = [candidate.id for candidate in slots if candidate.request is not None]
    known = [run.spent[name] for name in asked if name in run.spent]
    return total(known) if len(known) == len(asked) else None
