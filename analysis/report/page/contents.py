"""Everything that the page shows, as records; `page.html` holds them as JSON, and its script draws them.

Texts of candidates, models and names stand here as they came. They are data to the page's script, which sets them as
text only.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from tacevo.evolution.archive import AddStatus
from tacevo.records import Json, Operator, Reason, Stage

#: Corners of a polygon in order, each (x, y) in [0, 1].
Corners = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """A source text, with what its parts are."""

    text: str
    #: Runs of letters in the order of the text, as `k3 t1 d7 `: a class of `sources.CLASSES` and a length in UTF-16
    #: units, which is how the page's script counts.
    marks: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """What a candidate kept of a parent's lines."""

    parent: str
    #: (first line of the parent, first line of the child, number of lines), from 0, rising in both.
    kept: tuple[tuple[int, int, int], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """One candidate; a field that its ledger line lacks is None."""

    id: str
    generation: int
    slot: int
    operator: Operator
    parents: tuple[str, ...]
    #: Number of its instruction in `RunContents.instructions`; None for all but mutations.
    prompt: int | None
    #: The temperature that was planned, and whether the request was sent with it.
    temperature: float | None
    temperature_sent: bool
    #: Where and why earlier answers for this slot were rejected and sent back.
    repairs: tuple[tuple[Stage, Reason], ...]
    stage: Stage | None
    reason: Reason | None
    #: Key of its source in `PageContents.sources`; None where it was rejected, or its file is not the ledger's.
    source: str | None
    #: Of a rejected candidate: the reason in words and the model's answer; None where its file is missing.
    rejected: str | None
    changes: tuple[Change, ...]
    parameters: int | None
    flops: int | None
    #: Its descriptors on the axes of the archive, in their units; empty where nothing was measured.
    point: tuple[float, ...]
    #: What the search knew at its end (`Run.fitness`); None also where its source failed when it was trained again.
    fitness: float | None
    #: What was recorded when it came.
    first_loss: float | None
    train_losses: tuple[float, ...]
    validation_losses: tuple[float, ...]
    #: The last loss of each training seed of its source in the search, where there are several; None of a failure.
    seed_losses: tuple[float | None, ...] = ()
    #: Fitness of further trainings of the same source with other seeds.
    reestimates: tuple[float, ...] = ()
    #: The niche that it had when it came, and what the archive did with it.
    niche: int | None
    status: AddStatus | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Generation:
    """How a generation ended."""

    generation: int
    temperature: float
    candidates: int
    #: First answers that were trained, and those that were rejected, by stage.
    trained: int
    rejected: Mapping[Stage, int]
    best: float | None
    archive_median: float | None
    generation_median: float | None
    #: In [0, 1].
    coverage: float
    prompt_coverage: float
    qd_score: float
    #: What its answers cost; None where that is not known of all of them.
    tokens: int | None
    usd: float | None
    #: (low, high) of each axis that its niches were looked up under; empty before anything was trained.
    bounds: tuple[tuple[float, float], ...]
    #: (niche or place, id) of every elite of the network archive after it.
    elites: tuple[tuple[int, str], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """An occupied niche of the prompt archive."""

    niche: int
    #: Number of the instruction.
    prompt: int
    temperature: float
    curiosity: float
    inserted: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Yield:
    """What came of the mutations of one instruction, or of one band of temperatures."""

    name: str
    tried: int
    inserted: int
    #: Wilson's interval of inserted / tried; None where nothing was tried.
    interval: tuple[float, float] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class TableContents:
    """A table whose cells are rounded already."""

    caption: str
    columns: tuple[str, ...]
    #: Whether each column holds numbers.
    numeric: tuple[bool, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tested:
    """A network of a study."""

    name: str
    id: str
    #: The primary metric of every seed, in the order of the seeds.
    values: tuple[float, ...]
    #: Of its comparison with the baseline; None of the baseline, and where nothing could be compared.
    verdict: str | None
    #: Test images by (true class, predicted class) under its median seed; None of a regression.
    confusion: tuple[tuple[int, ...], ...] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyContents:
    """A study of a run."""

    name: str
    metric: str
    lower_is_better: bool
    #: Of the outputs: regressed values or classes.
    names: tuple[str, ...]
    networks: tuple[Tested, ...]
    tables: tuple[TableContents, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """A quantity over the seeds of an arm, by generation; None before it has a value."""

    low: tuple[float | None, ...]
    median: tuple[float | None, ...]
    high: tuple[float | None, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmContents:
    """An arm of a sweep."""

    name: str
    #: Quartiles over its seeds, by quantity.
    bands: Mapping[str, Band]
    #: (seed, value at the end), by quantity.
    ends: Mapping[str, tuple[tuple[int, float], ...]]


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepContents:
    """The comparison of a sweep's arms; none where its jobs cannot be compared."""

    #: The reference first.
    arms: tuple[ArmContents, ...]
    tables: tuple[TableContents, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunContents:
    """A run."""

    name: str
    #: Three lines that stand first: what was searched; by what model, with which data; and what stands behind it.
    headlines: tuple[str, str, str]
    #: What a reader has to know before anything else, e.g. what is missing; a sentence each.
    remarks: tuple[str, ...]
    #: Names of the archive's axes, as a figure has them.
    axes: tuple[str, ...]
    #: The cell of every niche of the network archive; empty where it has no niches.
    cells: tuple[Corners, ...]
    #: How many elites the archive can hold.
    places: int
    #: (id, text) of the library, and the text that asks for crossovers.
    instructions: tuple[tuple[str, str], ...]
    crossover: str
    candidates: tuple[Candidate, ...]
    generations: tuple[Generation, ...]
    prompt_cells: tuple[Corners, ...]
    #: Niches of the prompt archive that no trial could reach.
    unreachable: tuple[int, ...]
    trials: tuple[Trial, ...]
    by_instruction: tuple[Yield, ...]
    by_temperature: tuple[Yield, ...]
    studies: tuple[StudyContents, ...]
    tables: tuple[TableContents, ...]
    #: Sample images of the data set as a `data:` address of a PNG; None where they were not drawn.
    samples: str | None
    #: (name, value) of all that it follows from and was made with.
    provenance: tuple[tuple[str, str], ...]
    #: The settings that decide its results.
    settings: Mapping[str, Json]


@dataclass(frozen=True, slots=True, kw_only=True)
class PageContents:
    """The whole page."""

    title: str
    #: Of a running search; the page then reloads itself.
    live: bool
    #: A sentence on how the search stands, of a live page.
    state: str
    #: At least one, but for a live page of a search that has only begun.
    runs: tuple[RunContents, ...]
    #: None of a single run.
    sweep: SweepContents | None
    #: By hash; runs of a sweep share many.
    sources: Mapping[str, Source]
    #: What was checked before this was written, a sentence each; and the commands that check the rest.
    checked: tuple[str, ...]
    commands: tuple[str, ...]
