"""Training elites again, as part of a generation: the extraction of Extract-ME; pure.

Flageat, Huber, Helenon, Doncieux and Cully 2025, arXiv:2502.06585: a part of each generation's evaluations goes to
elites, whose samples accumulate, and each elite competes again by what all its samples say. Theirs keeps several
solutions in a cell, so that another can take the place of an elite that sinks; here the archive's history keeps all of
them. Theirs draws elites by rank; here those with the fewest trainings come first, so that none stays on a lucky draw.
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from tacevo.choices import FitnessRule
from tacevo.evolution.archive import Growing, NetworkArchive, Tessellation, TopK
from tacevo.evolution.lines import CandidateLine, ReevaluationLine, TrainedLine, source_hash
from tacevo.evolution.proposals import Candidate, Settings
from tacevo.randomness import stream
from tacevo.rounding import rounded


@dataclass(frozen=True, slots=True, kw_only=True)
class Reevaluation:
    """A slot of a generation that trains an elite again instead of asking for a network."""

    generation: int
    slot: int
    #: Id of the elite.
    elite: str
    source: str
    #: Numbers of the training seeds, none of which it was trained with before.
    seeds: range
    #: Nothing is asked for.
    request: None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimates:
    """All losses of each source that was trained, by its SHA-256; infinite where a training failed."""

    losses: Growing[str, tuple[float, ...]] = field(default_factory=Growing)
    #: What one loss is of the losses of its training.
    rule: FitnessRule = FitnessRule.last

    def after(self, line: TrainedLine) -> "Estimates":
        """Return the estimates after a line that has a source, and a training or the failure of one.

        A candidate of a known source brings no new draw, because its seeds are those of the first one. Nor does an
        elite that the gate, under later rules than those it was found under, did not let through to its training.
        """
        if isinstance(line, ReevaluationLine) and line.evaluation is None:
            return self
        source, known = str(line.source), self.losses.get(str(line.source), ())
        if known and isinstance(line, CandidateLine):
            return self
        return replace(self, losses=self.losses.adding(source, (*known, *losses_of(line, self.rule))))

    def fitness(self, source: str) -> float:
        """Return the median of a source's losses, as they are rounded; infinite where a training failed.

        A network that does not train with every seed is out: a median over the others would reward it for failing.
        """
        losses = self.losses[source]
        return math.inf if math.inf in losses else rounded(statistics.median(losses))


def losses_of(line: TrainedLine, rule: FitnessRule) -> tuple[float, ...]:
    """Return the fitness of each training of a line, seed by seed; an infinite one of a failure."""
    if line.fitness is None:
        return (math.inf,)
    return tuple(rule.of(one.validation_losses) for one in line.seeds) or (line.fitness,)


def estimates_of(lines: Sequence[object], rule: FitnessRule) -> Estimates:
    """Collect the losses of every source from the lines of a ledger whose fitness follows this rule."""
    estimates = Estimates(rule=rule)
    for line in lines:
        if isinstance(line, ReevaluationLine) or (isinstance(line, CandidateLine) and line.fitness is not None):
            estimates = estimates.after(line)
    return estimates


def fitness_by_id(lines: Sequence[object], rule: FitnessRule) -> dict[str, float]:
    """Return what a search knew of the fitness of each trained candidate at the end of some lines, by id.

    It is the recorded fitness, or the estimate where the search trained elites again. A candidate whose source failed
    then is left out. Lines of candidates and of re-evaluations need not be mixed in the order of the slots.
    """
    trained = [line for line in lines if isinstance(line, CandidateLine) and line.fitness is not None]
    if any(isinstance(line, ReevaluationLine) for line in lines):
        estimates = estimates_of(lines, rule)
        known = {line.id: estimates.fitness(str(line.source)) for line in trained}
        return {name: fitness for name, fitness in known.items() if math.isfinite(fitness)}
    return {line.id: line.fitness for line in trained if line.fitness is not None}


def plan_reevaluations(
    elites: Sequence[Candidate], estimates: Estimates, settings: Settings, *, generation: int, number: int, seeds: int
) -> tuple[Reevaluation, ...]:
    """Plan which elites are trained again, `number` of them at most, each with so many further seeds.

    Those with the fewest trainings come first, by draw among equals; all sources of the elites, which are in the order
    of their niches, have estimates. They take the last slots of generation g >= 1, so that the others draw what they
    would draw without them.
    """
    if number == 0:
        return ()
    counts = [len(estimates.losses[source_hash(elite.source)]) for elite in elites]
    drawn = stream(settings.seed, "reevaluations", generation).permutation(len(elites)).tolist()
    chosen = sorted(drawn, key=lambda place: counts[place])[:number]
    return tuple(
        Reevaluation(
            generation=generation,
            slot=slot,
            elite=elites[place].id,
            source=elites[place].source,
            seeds=range(counts[place], counts[place] + seeds),
        )
        for slot, place in enumerate(chosen, start=settings.candidates - len(chosen))
    )


def compete_again(
    networks: NetworkArchive,
    candidates: Growing[str, Candidate],
    estimates: Estimates,
    niches: Tessellation | TopK,
    line: ReevaluationLine,
) -> tuple[NetworkArchive, Growing[str, Candidate], ReevaluationLine]:
    """Let all candidates of a source that was trained again compete by its estimate; return them, and the whole line.

    Who lost to them competes, too: the archive is filled again from its history. A failure puts the source out of the
    archive for good; one that the gate rejected is left as it is.
    """
    fitness = estimates.fitness(str(line.source))
    source = candidates[line.id].source
    names = [one.id for one in candidates.values() if one.source == source]
    for name in names:
        candidates = candidates.adding(name, replace(candidates[name], fitness=fitness))
    networks = networks.reestimated(niches, names, -fitness)
    kept = any(elite.name == line.id for elite in networks.archive.elites.values())
    return networks, candidates, replace(line, estimate=fitness if math.isfinite(fitness) else None, kept=kept)
