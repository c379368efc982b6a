"""A finished run as records: what tables, figures and studies are made from.

The ledger's chain and the run's digest are checked first, then both archives against the ledger's last generation; a
run that is not finished is rejected. Nothing is computed here beyond what the files hold.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacevo.choices import PAPER_AXES, ArchiveKind, Axis, Scale
from tacevo.config.identity import identity, task_hash
from tacevo.config.schema import RunConfig
from tacevo.costs import Spending
from tacevo.errors import RunError
from tacevo.evolution.archive import Bounds, best_distinct
from tacevo.evolution.chance import shortfall
from tacevo.evolution.descriptors import on_axis
from tacevo.evolution.files import (
    EliteEntry,
    Line,
    RunLine,
    TrialEntry,
    check_references,
    read_archives,
    read_finished,
    rules_of,
)
from tacevo.evolution.lines import CandidateLine, GenerationLine, ReevaluationLine, not_sent
from tacevo.evolution.reevaluation import fitness_by_id
from tacevo.records import DataFacts, Task, to_json
from tacevo.results.run import answered_by, read_config
from tacevo.rules import Rules
from tacevo.storage.canonical import differences, shown
from tacevo.storage.ledger import Sealed
from tacevo.storage.run_directory import RunDirectory, RunRecord
from tacevo.text import drawn, listed

#: How many of the best networks tables and figures look at, as the paper does.
TOP = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedRun:
    """A finished run."""

    path: Path
    name: str
    digest: str
    config: RunConfig
    facts: DataFacts
    #: Hash of the centroids of both archives.
    centroids: str
    #: Ids of the instructions, in the order of the prompt indices.
    instructions: tuple[str, ...]
    candidates: tuple[CandidateLine, ...]
    generations: tuple[GenerationLine, ...]
    elites: tuple[EliteEntry, ...]
    #: What the archive ended with; None where nothing was trained, or there are no niches.
    bounds: Bounds | None
    prompt_trials: tuple[TrialEntry, ...]
    #: What it was made under.
    rules: Rules
    #: Of Python and packages, by name.
    versions: Mapping[str, str]
    #: What the answers of a candidate cost, by its id, as far as timings.jsonl has it.
    spent: Mapping[str, Spending]
    #: The processor time of a candidate's trainings in seconds, by its id, as far as timings.jsonl has it.
    cpu_seconds: Mapping[str, float]
    #: The further trainings of elites, in order; none unless the search trained elites again.
    reevaluations: tuple[ReevaluationLine, ...] = ()
    #: The trivial loss of its validation images; None in runs of earlier releases.
    trivial: float | None
    #: What answered, in words.
    model: str

    @property
    def task(self) -> str:
        """The task's name."""
        return self.config.task.name

    @property
    def seeds(self) -> int:
        """The training seeds of a candidate, whose median loss is its fitness."""
        return self.config.training.seeds

    @property
    def record(self) -> str:
        """What a recorded fitness is, in words."""
        return drawn(self.seeds, or_more=self.config.archive.kind is ArchiveKind.extract)

    @property
    def fitness(self) -> Mapping[str, float]:
        """What the search knew of each trained candidate's fitness at its end, by id (`fitness_by_id`)."""
        return fitness_by_id((*self.candidates, *self.reevaluations))

    @property
    def has_niches(self) -> bool:
        """Whether its network archive keeps the best of every niche, and not the best of all."""
        return self.config.archive.kind is not ArchiveKind.best

    @property
    def places(self) -> int:
        """How many networks its archive can hold: one for each niche, or place."""
        return self.config.archive.niches if self.has_niches else self.config.archive.kept

    @property
    def baseline(self) -> CandidateLine:
        """The network that the search began with."""
        return self.candidates[0]

    @property
    def trained(self) -> tuple[CandidateLine, ...]:
        """The candidates that were trained, in order."""
        return tuple(candidate for candidate in self.candidates if candidate.fitness is not None)

    @property
    def answered(self) -> tuple[CandidateLine, ...]:
        """The candidates that a model was asked for: all but the baseline and given networks."""
        return tuple(candidate for candidate in self.candidates if candidate.request is not None)

    @property
    def shortfall(self) -> str:
        """That it learned or found nothing, and what to raise (`tacevo.evolution.chance`); empty where it did."""
        best, known = self.generations[-1].best, self.fitness.get(self.baseline.id)
        if best is None:
            return ""
        return shortfall(
            best=best,
            baseline=known,
            trivial=self.trivial,
            asked=bool(self.answered),
            usable=any(one.fitness is not None for one in self.answered),
        )

    @property
    def not_sent(self) -> Mapping[str, str]:
        """Words on the sampling settings that were not sent, by setting (see `tacevo.evolution.lines.not_sent`)."""
        return not_sent([one.dropped for one in self.answered])

    def ranked(self) -> tuple[EliteEntry, ...]:
        """Return the elites, best fitness first; the earlier candidate where two are equal."""
        return tuple(sorted(self.elites, key=lambda elite: (elite.fitness, elite.id)))

    def best(self, count: int = TOP) -> tuple[CandidateLine, ...]:
        """Return the best elites with distinct sources, at most `count`: those that a study would choose.

        The rule is `tacevo.evolution.archive.best_distinct`.
        """
        candidates = {candidate.id: candidate for candidate in self.candidates}
        entries = [(elite.fitness, elite.id, candidates[elite.id].source) for elite in self.elites]
        return tuple(candidates[name] for name in best_distinct(entries, self.baseline.source)[:count])


def descriptors_of(candidate: CandidateLine, scale: Scale, axes: Sequence[Axis] = PAPER_AXES) -> tuple[float, ...]:
    """Return the descriptors of a trained candidate, EffRatio on a scale, shape (axes,).

    Raises:
        ValueError: the gate rejected the candidate, so nothing was measured.
    """
    values = [getattr(candidate, axis) for axis in axes]
    if None in values:
        raise ValueError(f"{candidate.id} was not measured")
    return tuple(on_axis(axis, value, scale) for axis, value in zip(axes, values, strict=True))


def read_run(path: Path) -> RecordedRun:
    """Read the directory of a finished run.

    Raises:
        RunError: it does not hold a run, is not finished, or was damaged or edited; the message names the file.
    """
    directory = RunDirectory(path)
    return finished_run(directory, *read_finished(directory))


def finished_run(directory: RunDirectory, record: RunRecord, ledger: Sealed[Line]) -> RecordedRun:
    """Return a finished run whose run.json and ledger were read, with its archives.

    Raises:
        RunError: as `as_run`, or an archive is not what the ledger ends with.
    """
    run = as_run(directory.path, record, ledger)
    networks, prompts = read_archives(directory, run.generations[-1])
    return replace(run, elites=networks.elites, prompt_trials=prompts.trials)


def as_run(path: Path, record: RunRecord, ledger: Sealed[Line]) -> RecordedRun:
    """Return a run without its archives.

    Args:
        path: its directory.
        record: what its run.json holds.
        ledger: checked, with at least one generation, and nothing after the last one.

    Raises:
        RunError: candidates name others that are not there, or run.json has other settings or texts than the ledger.
    """
    check_references(path, record, ledger.lines)
    header = next(line for line in ledger.lines if isinstance(line, RunLine))
    config = read_config(path, record)
    _check_description(path, config, record.task, header)
    generations = tuple(line for line in ledger.lines if isinstance(line, GenerationLine))
    directory = RunDirectory(path)
    return RecordedRun(
        path=path,
        name=path.resolve().name,
        digest=ledger.digest,
        config=config,
        facts=header.data,
        centroids=header.centroids,
        instructions=tuple(instruction.id for instruction in record.task.instructions),
        candidates=tuple(line for line in ledger.lines if isinstance(line, CandidateLine)),
        reevaluations=tuple(line for line in ledger.lines if isinstance(line, ReevaluationLine)),
        generations=generations,
        elites=(),
        bounds=generations[-1].bounds,
        prompt_trials=(),
        rules=rules_of(ledger.lines),
        versions=record.versions,
        spent=directory.read_spending(),
        cpu_seconds={one.id: one.cpu_seconds for one in directory.read_timings() if one.id and one.cpu_seconds},
        trivial=record.trivial,
        model=answered_by(record, config.llm),
    )


def _check_description(path: Path, config: RunConfig, task: Task, header: RunLine) -> None:
    """Check that run.json has the configuration and the task of the ledger's first line."""
    differing = [shown(field) for field in differences(header.config, to_json(identity(config)))]
    if task_hash(task) != header.task:
        differing.append("task")
    if differing:
        raise RunError(
            f"other values of {listed(differing)}",
            place=f"{path}/run.json",
            expected="the configuration and the task that the ledger begins with",
            remedy="restore the file",
        )
