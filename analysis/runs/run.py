"""A finished run as records: what tables, figures and studies are made from.

The ledger's chain and the run's digest are checked before anything is believed, and both archives against what the
ledger ends with; a run that is not finished is refused. Nothing is computed here beyond what the files hold.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from tacevo.choices import ArchiveKind, Axis, Scale
from tacevo.costs import Spending
from tacevo.errors import RunError
from tacevo.records import DataFacts, Json, Operator, Reason, Stage, to_json
from tacevo.search.archive import best_of_their_own
from tacevo.search.descriptors import scaled
from tacevo.search.files import EliteEntry, TrialEntry, read_archives, read_finished
from tacevo.search.lines import CandidateLine, GenerationLine, RulesLine, RunLine, eras_of
from tacevo.search.unsent import not_sent
from tacevo.storage.canonical import content_hash
from tacevo.storage.run_directory import RunDirectory, RunRecord

#: How many of the best networks tables and figures look at, as the paper does.
TOP = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """What the probe measured of an admitted candidate."""

    parameters: int
    #: Of one image, forwards.
    flops: int
    arch_div: float
    eff_ratio: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Trained:
    """How a candidate's short training went, and where the archives put it."""

    #: Final validation loss; lower is better.
    fitness: float
    #: After every epoch.
    validation_losses: tuple[float, ...]
    niche: int
    #: `new`, `improved` or `rejected`, as in `tacevo.search.archive.AddStatus`.
    status: str

    @property
    def inserted(self) -> bool:
        """Whether the network archive took it when it came."""
        return self.status != "rejected"


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """One slot of a search, as its ledger has it."""

    id: str
    generation: int
    slot: int
    operator: Operator
    parents: tuple[str, ...]
    #: Index of the instruction; None for a crossover and the baseline.
    prompt: int | None
    #: That its request was sent with; None for the baseline, and where the model refuses it.
    temperature: float | None
    #: SHA-256 of the source; None where the gate found no class.
    source: str | None
    #: Key of its evaluation; equal sources share one.
    evaluation: str | None
    #: Where and why it was turned away; None for a trained one.
    stage: Stage | None
    reason: Reason | None
    #: None where the gate turned it away.
    measured: Measured | None
    #: None where it was turned away.
    trained: Trained | None
    #: What its answers cost; None where timings.jsonl does not tell.
    spent: Spending | None
    #: Where and why answers before its last were turned away, in order; empty unless answers go back for repair.
    sent_back: tuple[tuple[Stage, Reason], ...] = ()
    #: Sampling settings that its request was sent without, because the model refuses them.
    dropped: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Generation:
    """One generation, as its ledger line has it."""

    generation: int
    #: T_g, the centre of its requests' temperatures.
    temperature: float
    candidates: int
    #: First answers that were trained.
    trained: int
    #: The archive's best fitness after it; None before anything was trained.
    best: float | None
    #: Median fitness of its own candidates; None where none was trained.
    generation_median: float | None
    #: Occupied part of the niches, in [0, 1].
    coverage: float
    qd_score: float
    prompt_coverage: float

    @property
    def trainable(self) -> float:
        """The part of its slots whose first answer was trained, in [0, 1]."""
        return self.trained / self.candidates


@dataclass(frozen=True, slots=True, kw_only=True)
class Elite:
    """An elite of the network archive."""

    id: str
    niche: int
    fitness: float
    #: (ArchDiv, EffRatio), the latter as the archive's axis has it.
    descriptors: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class PromptTrial:
    """The trial that holds a niche of the prompt archive."""

    niche: int
    prompt: int
    temperature: float
    inserted: bool
    curiosity: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A finished run."""

    path: Path
    name: str
    digest: str
    #: The resolved configuration, as run.json has it.
    config: Mapping[str, Json]
    facts: DataFacts
    #: Hash of the centroids of both archives.
    centroids: str
    #: Ids of the instructions, in the order of the prompt indices.
    instructions: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    generations: tuple[Generation, ...]
    elites: tuple[Elite, ...]
    #: The (low, high) of each axis that the archive ended with; None where nothing was trained, or there are no niches.
    bounds: tuple[tuple[float, float], ...] | None
    prompt_trials: tuple[PromptTrial, ...]
    #: The rules that it was made under, from which generation on; at least one.
    eras: tuple[RulesLine, ...]

    @property
    def task(self) -> str:
        """The task's name."""
        return str(self.config["task"]["name"])

    @property
    def has_niches(self) -> bool:
        """Whether its network archive keeps the best of every niche, and not the best of all."""
        return ArchiveKind(self.config["archive"].get("kind", ArchiveKind.cvt)) is ArchiveKind.cvt

    @property
    def places(self) -> int:
        """How many networks its archive can hold: one for each niche, or place."""
        return int(self.config["archive"]["niches" if self.has_niches else "kept"])

    @property
    def axes(self) -> tuple[Axis, ...]:
        """What the axes of its network archive measure."""
        return tuple(Axis(axis) for axis in self.config["archive"].get("axes", Axis))

    @property
    def baseline(self) -> Candidate:
        """The network that the search began with."""
        return self.candidates[0]

    @property
    def not_sent(self) -> Mapping[str, str]:
        """Words on the sampling settings that were not sent, by setting (see `tacevo.search.unsent.not_sent`)."""
        return not_sent([one.dropped for one in self.candidates if one.operator is not Operator.baseline])

    def ranked(self) -> tuple[Elite, ...]:
        """Give the elites, best fitness first; the earlier candidate where two are equal."""
        return tuple(sorted(self.elites, key=lambda elite: (elite.fitness, elite.id)))

    def best(self, count: int = TOP) -> tuple[Candidate, ...]:
        """Give the best elites that are networks of their own, at most `count`: those that a study would choose.

        The rule is `tacevo.search.archive.best_of_their_own`.
        """
        candidates = {candidate.id: candidate for candidate in self.candidates}
        entries = [(elite.fitness, elite.id, candidates[elite.id].source) for elite in self.elites]
        return tuple(candidates[name] for name in best_of_their_own(entries, self.baseline.source)[:count])


def load_run(path: Path) -> Run:
    """Read the folder of a finished run.

    Raises:
        RunError: it is no run, is not finished, or was damaged or edited; the message names the file.
    """
    directory = RunDirectory(path)
    record, ledger = read_finished(directory)
    eras = eras_of(ledger.lines)
    header = next(line for line in ledger.lines if isinstance(line, RunLine))
    _refuse_edited(path, record, header)
    generations = [line for line in ledger.lines if isinstance(line, GenerationLine)]
    networks, prompts = read_archives(directory, generations[-1])
    spent = directory.read_spending()
    candidates = tuple(_candidate(line, spent) for line in ledger.lines if isinstance(line, CandidateLine))
    return Run(
        path=path,
        name=path.resolve().name,
        digest=ledger.digest,
        config=record.config,
        facts=header.data,
        centroids=header.centroids,
        instructions=tuple(entry.id for entry in record.task.instructions),
        candidates=candidates,
        generations=tuple(map(_generation, generations)),
        elites=_elites(networks.elites, candidates, Scale(record.config["archive"]["eff_ratio_scale"])),
        bounds=None if networks.bounds is None else tuple(zip(networks.bounds.low, networks.bounds.high, strict=True)),
        prompt_trials=tuple(map(_trial, prompts.trials)),
        eras=eras,
    )


def _refuse_edited(path: Path, run: RunRecord, header: RunLine) -> None:
    """Compare configuration and task in run.json with the ledger's first line, as far as that has them."""
    numerics = run.config.get("numerics")
    told = {**run.config, "numerics": numerics.get("kind") if isinstance(numerics, dict) else numerics}
    for key, group in header.config.items():
        if isinstance(group, dict) and isinstance(told.get(key), dict):
            told[key] = {name: told[key].get(name) for name in group}
    if {key: told.get(key) for key in header.config} != header.config or content_hash(to_json(run.task)) != header.task:
        raise RunError(
            "another one",
            place=f"{path}/run.json",
            expected="the configuration and the task of the ledger",
            remedy="restore it",
        )


def _candidate(line: CandidateLine, spent: Mapping[str, Spending]) -> Candidate:
    return Candidate(
        id=line.id,
        generation=line.generation,
        slot=line.slot,
        operator=line.operator,
        parents=line.parents,
        prompt=line.prompt,
        temperature=line.sent_temperature,
        source=line.source,
        evaluation=line.evaluation,
        stage=line.stage,
        reason=line.reason,
        measured=_measured(line),
        trained=_trained(line),
        spent=spent.get(line.id),
        sent_back=tuple((sent.stage, sent.reason) for sent in line.repairs),
        dropped=line.dropped,
    )


def _measured(line: CandidateLine) -> Measured | None:
    if line.parameters is None or line.flops is None or line.arch_div is None or line.eff_ratio is None:
        return None
    return Measured(parameters=line.parameters, flops=line.flops, arch_div=line.arch_div, eff_ratio=line.eff_ratio)


def _trained(line: CandidateLine) -> Trained | None:
    if line.fitness is None or line.validation_losses is None or line.niche is None or line.status is None:
        return None
    return Trained(fitness=line.fitness, validation_losses=line.validation_losses, niche=line.niche, status=line.status)


def _generation(line: GenerationLine) -> Generation:
    return Generation(**{field.name: getattr(line, field.name) for field in fields(Generation)})


def _elites(entries: Sequence[EliteEntry], candidates: Sequence[Candidate], scale: Scale) -> tuple[Elite, ...]:
    """Read the elites; their descriptors are those of the ledger, which the hash of an archive does not cover."""
    measured = {candidate.id: candidate.measured for candidate in candidates if candidate.measured}
    return tuple(
        Elite(
            id=entry.id,
            niche=entry.niche,
            fitness=entry.fitness,
            descriptors=(measured[entry.id].arch_div, scaled(measured[entry.id].eff_ratio, scale)),
        )
        for entry in entries
    )


def _trial(entry: TrialEntry) -> PromptTrial:
    return PromptTrial(**{field.name: getattr(entry, field.name) for field in fields(PromptTrial)})
