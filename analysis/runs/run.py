"""A finished run as records: what tables, figures and studies are made from.

The ledger's chain and the run's digest are checked before anything is believed, and both archives against what the
ledger ends with; a run that is not finished is refused. Nothing is computed here beyond what the files hold.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tacevo.choices import ArchiveKind, Axis, Scale
from tacevo.costs import Spending
from tacevo.errors import RunError
from tacevo.records import DataFacts, Json, Operator, Reason, Stage
from tacevo.rules import Era, eras_of
from tacevo.search.archive import best_of_their_own
from tacevo.search.descriptors import scaled
from tacevo.search.unsent import dropped_settings, not_sent, sent_temperature
from tacevo.storage.canonical import content_hash
from tacevo.storage.run_directory import RunDirectory

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
    eras: tuple[Era, ...]

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
    lines = directory.read_finished()
    run = directory.read_run()
    spent = directory.read_spending()
    with directory.believed():
        _refuse_edited(path, run, lines[0])
        archive, prompts = directory.read_archives(lines)
        candidates = tuple(_candidate(line, spent) for line in lines if line["kind"] == "candidate")
        return Run(
            path=path,
            name=path.resolve().name,
            digest=run["digest"],
            config=run["config"],
            facts=DataFacts.from_json(lines[0]["data"]),
            centroids=lines[0]["centroids"],
            instructions=tuple(entry["id"] for entry in run["task"]["instructions"]),
            candidates=candidates,
            generations=tuple(_generation(line) for line in lines if line["kind"] == "generation"),
            elites=_elites(archive["elites"], candidates, Scale(run["config"]["archive"]["eff_ratio_scale"])),
            bounds=None if archive["bounds"] is None else _bounds(archive["bounds"]),
            prompt_trials=tuple(_trial(entry) for entry in prompts["trials"]),
            eras=eras_of(lines),
        )


def _refuse_edited(path: Path, run: Mapping[str, Json], header: Mapping[str, Json]) -> None:
    """Hold configuration and task in run.json against the ledger's first line, as far as that has them."""
    config = {**run["config"], "numerics": run["config"]["numerics"]["kind"]}
    told = {
        key: {name: config[key].get(name) for name in value} if isinstance(value, dict) else config[key]
        for key, value in header["config"].items()
    }
    if told != header["config"] or content_hash(run["task"]) != header["task"]:
        raise RunError(f"{path}/run.json was edited: its configuration or task is not that of the ledger; restore it")


def _candidate(line: Mapping[str, Json], spent: Mapping[str, Spending]) -> Candidate:
    return Candidate(
        id=line["id"],
        generation=line["generation"],
        slot=line["slot"],
        operator=Operator(line["operator"]),
        parents=tuple(line["parents"]),
        prompt=line["prompt"],
        temperature=sent_temperature(line),
        source=line.get("source"),
        evaluation=line.get("evaluation"),
        stage=Stage(line["stage"]) if "stage" in line else None,
        reason=Reason(line["reason"]) if "reason" in line else None,
        measured=_measured(line) if "parameters" in line else None,
        trained=_trained(line) if "fitness" in line else None,
        spent=spent.get(line["id"]),
        sent_back=tuple((Stage(sent["stage"]), Reason(sent["reason"])) for sent in line.get("repairs", ())),
        dropped=dropped_settings(line),
    )


def _measured(line: Mapping[str, Json]) -> Measured:
    return Measured(
        parameters=line["parameters"], flops=line["flops"], arch_div=line["arch_div"], eff_ratio=line["eff_ratio"]
    )


def _trained(line: Mapping[str, Json]) -> Trained:
    return Trained(
        fitness=line["fitness"],
        validation_losses=tuple(line["validation_losses"]),
        niche=line["niche"],
        status=line["status"],
    )


def _generation(line: Mapping[str, Json]) -> Generation:
    names = ("generation", "temperature", "candidates", "trained", "best", "generation_median")
    return Generation(**{name: line[name] for name in (*names, "coverage", "qd_score", "prompt_coverage")})


def _elites(entries: Sequence[Mapping[str, Json]], candidates: Sequence[Candidate], scale: Scale) -> tuple[Elite, ...]:
    """Read the elites; their descriptors are those of the ledger, which the hash of an archive does not cover."""
    measured = {candidate.id: candidate.measured for candidate in candidates if candidate.measured}
    return tuple(
        Elite(
            id=entry["id"],
            niche=entry["niche"],
            fitness=entry["fitness"],
            descriptors=(measured[entry["id"]].arch_div, scaled(measured[entry["id"]].eff_ratio, scale)),
        )
        for entry in entries
    )


def _bounds(value: Mapping[str, Json]) -> tuple[tuple[float, float], ...]:
    return tuple(zip(value["low"], value["high"], strict=True))


def _trial(entry: Mapping[str, Json]) -> PromptTrial:
    names = ("niche", "prompt", "temperature", "inserted", "curiosity")
    return PromptTrial(**{name: entry[name] for name in names})
