"""A finished run as it was recorded, read and checked once: for commands, replays, studies, tables and pages.

The ledger's chain and the run's digest are checked first, then the texts and settings of run.json against the ledger's
first line, then both archives against its last generation. Nothing is computed here beyond what the files hold.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Self

from tacevo.choices import PAPER_AXES, Carrier, Scale
from tacevo.config.identity import identity, task_hash
from tacevo.config.recorded_parts import constant
from tacevo.config.schema import RunConfig, StoreConfig
from tacevo.config.sources import are_grouped
from tacevo.costs import Spending
from tacevo.environment import doubting
from tacevo.errors import RunError
from tacevo.evolution.archive import AxisBounds, best_distinct
from tacevo.evolution.carriers import LEVELS
from tacevo.evolution.chance import shortfall
from tacevo.evolution.descriptors import on_axis
from tacevo.evolution.lines import (
    TEMPERATURE,
    CandidateLine,
    GenerationLine,
    not_sent,
    trained_networks,
    training_flops,
)
from tacevo.evolution.run_files import (
    EliteEntry,
    Line,
    NetworkArchiveFile,
    PromptFile,
    RunLine,
    TrialEntry,
    check_references,
    read_archives,
    read_finished,
    rules_of,
)
from tacevo.gate.likeness import is_same_network
from tacevo.parts.kinds import ARCHIVES, PROMPTS, SOURCES
from tacevo.records import DataFacts, to_json
from tacevo.results.settings import found_data, read_settings
from tacevo.rules import Rules
from tacevo.storage.canonical import differences, shown, value_at
from tacevo.storage.ledger import Sealed
from tacevo.storage.run_directory import FinishedDirectory, RunDirectory, RunRecord
from tacevo.storage.store import place_of
from tacevo.text import counted, listed

#: The number of best networks that tables and figures look at, as the paper does.
TOP = 4


@dataclass(frozen=True, kw_only=True)
class RecordedRun:
    """A finished run; what is read of its files beyond these fields is read when it is first asked for.

    A summary takes one that was stopped, too: of as many lines as there are, with the elites of the last archive.
    """

    directory: RunDirectory
    #: The content of run.json.
    record: RunRecord
    #: The configuration as this machine may use it, see `tacevo.results.settings`.
    config: RunConfig
    #: Checked; of a finished run with at least one generation, and nothing after the last one.
    ledger: Sealed[Line]
    #: Its files, as they were read; None where the archives followed from the ledger.
    archives: tuple[NetworkArchiveFile, PromptFile] | None = None
    #: The elites of the network archive.
    elites: tuple[EliteEntry, ...] = ()
    #: The trials of the prompt archive.
    prompt_trials: tuple[TrialEntry, ...] = ()
    #: True where its stores keep the test predictions of its studies; those of a published sweep do not.
    has_predictions: bool = True
    #: The entries of its bundle; None where its stores are the directory that the configuration names.
    packed: Path | None = None

    @property
    def path(self) -> Path:
        """Its directory."""
        return self.directory.path

    @cached_property
    def name(self) -> str:
        """The name of its directory."""
        return self.path.resolve().name

    @property
    def digest(self) -> str:
        """The last hash of its ledger."""
        return self.ledger.digest

    @property
    def stores(self) -> Path:
        """The directory of its stores, which hold its recorded answers."""
        return self.packed or Path(self.config.store.root)

    @cached_property
    def with_data(self) -> RunConfig:
        """Its configuration, with its data set where that lies on this machine (`found_data`)."""
        root = found_data(self.directory, self.config)
        return replace(self.config, data=replace(self.config.data, root=root))

    @cached_property
    def without_stores(self) -> str:
        """A sentence that its stores are not where they are looked for; empty where they hold its first training."""
        known = next((line.evaluation for line in self.trained if line.evaluation is not None), None)
        if known is None or (self.stores / place_of("evaluations", known)).exists():
            return ""
        return f"its stores are not in {self.stores}, so what rests on them is missing: store=DIR or --store names them"

    def check_stores(self, option: str) -> None:
        """Check that its stores are there, before something is written into them; `option` is how a user names them.

        Raises:
            RunError: they are not: what the recorded name leads to from here may be anyone's.
        """
        if self.without_stores:
            raise RunError(
                f"none in {self.stores}",
                place=f"the stores of {self.path}",
                expected="the directory that holds the trainings of the run",
                remedy=f"name it with {option}; another one, or a new one, is named alike",
            )

    @property
    def stores_found(self) -> str:
        """A line on where its stores were found; empty where that is the name that it recorded."""
        recorded = value_at(self.record.config, ("store", "root"))
        return "" if self.packed or recorded == str(self.stores) else f"stores: {self.stores} (recorded as {recorded})"

    @property
    def task(self) -> str:
        """The task's name."""
        return self.config.task.name

    @cached_property
    def header(self) -> RunLine:
        """The first line of its ledger."""
        return next(line for line in self.ledger.lines if isinstance(line, RunLine))

    @property
    def facts(self) -> DataFacts:
        """Its data set's."""
        return self.header.data

    @property
    def instructions(self) -> tuple[str, ...]:
        """Ids of the instructions, in the order of the prompt indices."""
        return tuple(instruction.id for instruction in self.record.task.instructions)

    @cached_property
    def candidates(self) -> tuple[CandidateLine, ...]:
        """The candidates' lines, in order; the baseline's first."""
        return tuple(line for line in self.ledger.lines if isinstance(line, CandidateLine))

    @cached_property
    def generations(self) -> tuple[GenerationLine, ...]:
        """The generations' lines; of a finished run one at least."""
        return tuple(line for line in self.ledger.lines if isinstance(line, GenerationLine))

    @cached_property
    def rules(self) -> Rules:
        """The numbers of the rules that it was made under."""
        return rules_of(self.ledger.lines)

    @property
    def bounds(self) -> AxisBounds | None:
        """The bounds that the archive ended with; None where nothing was trained, or there are no niches."""
        return self.generations[-1].bounds

    @property
    def baseline(self) -> CandidateLine:
        """The network that the search began with."""
        return self.candidates[0]

    @cached_property
    def trained(self) -> tuple[CandidateLine, ...]:
        """The candidates that were trained, in order."""
        return tuple(candidate for candidate in self.candidates if candidate.fitness is not None)

    @cached_property
    def answered(self) -> tuple[CandidateLine, ...]:
        """The candidates that a model was asked for: all but the baseline and given networks."""
        return tuple(candidate for candidate in self.candidates if candidate.request is not None)

    @cached_property
    def fitness(self) -> Mapping[str, float]:
        """The fitness of each trained candidate, by id."""
        return {line.id: line.fitness for line in self.candidates if line.fitness is not None}

    @cached_property
    def copies(self) -> frozenset[str]:
        """The ids of the candidates that are the network of one of their parents, and so no new network.

        They may be written with other comments, docstrings or layout. A source whose file is missing, or was edited, is
        compared with none but those of its hash.
        """
        known = {candidate.id: candidate for candidate in self.candidates}
        return frozenset(
            candidate.id
            for candidate in self.candidates
            if candidate.source is not None
            and any(self._is_copy(candidate, known[parent]) for parent in candidate.parents if parent in known)
        )

    def _is_copy(self, child: CandidateLine, parent: CandidateLine) -> bool:
        """Return whether two candidates are one network; of unlike profiles they are not, and no text is read."""
        if child.source == parent.source:
            return True
        if parent.source is None or (child.parameters, child.flops) != (parent.parameters, parent.flops):
            return False
        texts = [self.directory.read_checked(line.id, line.source) for line in (child, parent)]
        first, second = (None if is_edited or text is None else text.decode() for text, is_edited in texts)
        return first is not None and second is not None and is_same_network(first, second)

    @cached_property
    def spent(self) -> Mapping[str, Spending]:
        """The cost of the answers of a candidate, by its id, as far as timings.jsonl has it."""
        return self.directory.read_spending()

    @cached_property
    def cpu_seconds(self) -> Mapping[str, float]:
        """The processor time of a candidate's trainings in seconds, by its id, as far as timings.jsonl has it."""
        return {one.id: one.cpu_seconds for one in self.directory.read_timings() if one.id and one.cpu_seconds}

    @property
    def training_flops(self) -> int:
        """The FLOPs of its trainings, as its budget counts them (`tacevo.evolution.lines.training_flops`)."""
        images, training = self.record.data.counts[0], self.config.training
        trained = trained_networks(self.candidates)
        return training_flops(trained, images=images, epochs=training.epochs)

    @property
    def has_prompts(self) -> bool:
        """True where it has a prompt archive."""
        return constant(self.config, PROMPTS, "records")

    @property
    def has_niches(self) -> bool:
        """True where its network archive keeps the best of every niche, and not the best of all."""
        return constant(self.config, ARCHIVES, "has_niches")

    @property
    def places(self) -> int:
        """The most networks that its archive can hold: one for each niche, or `archive.kept`."""
        return self.config.archive.niches if self.has_niches else self.config.archive.kept

    @property
    def model(self) -> str:
        """The name of the model that answered; where another server answered, the text says whose word the name is."""
        llm = self.config.llm
        if not self.record.elsewhere:
            return llm.name
        whose = "the name is a label" if llm.label else "under this name"
        return f"{llm.name}, asked through another server, {whose}"

    @property
    def shortfall(self) -> str:
        """A warning that it learned or found nothing, with what to raise (`tacevo.evolution.chance`); else empty."""
        best, known = self.generations[-1].best, self.fitness.get(self.baseline.id)
        if best is None:
            return ""
        return shortfall(
            best=best,
            baseline=known,
            trivial=self.record.trivial,
            asked=bool(self.answered),
            usable=any(one.fitness is not None for one in self.answered),
            sized=self.config.data.source in SOURCES.ours,
        )

    @property
    def not_sent(self) -> Mapping[str, str]:
        """Words on the sampling settings that were not sent, by setting (see `tacevo.evolution.lines.not_sent`)."""
        refused = not_sent([one.dropped for one in self.answered], thinks=self.config.llm.thinks)
        if self.carrier is not Carrier.none:
            return refused
        return {TEMPERATURE: "temperature was not sent: temperature.carrier=none", **refused}

    @property
    def carrier(self) -> Carrier:
        """The carrier of the requests' temperatures."""
        return self.config.temperature.carrier

    @property
    def carried(self) -> str:
        """Words on the carrier, for behind the name of a temperature; empty where it is sent as such."""
        by = "nothing" if self.carrier is Carrier.none else self.carrier
        return "" if self.carrier is Carrier.parameter else f" (carried by {by})"

    @property
    def carrier_note(self) -> str:
        """A sentence on what the temperatures chose in their own place; empty where they chose nothing."""
        if self.carrier is Carrier.words:
            return f"T is carried by words: it chooses one of {LEVELS} sentences of the task's library."
        if self.carrier is Carrier.effort:
            return f"T is carried by effort: it chooses one of {listed(self.config.temperature.efforts)}."
        return ""

    @property
    def on_sampling(self) -> tuple[str, ...]:
        """Remarks on what carries temperatures, and on settings that were not sent."""
        return (*([self.carrier_note] if self.carrier_note else []), *self.not_sent.values())

    @property
    def levels(self) -> int:
        """The number of sentences or efforts of which temperatures choose one; 0 where they choose none."""
        efforts = len(self.config.temperature.efforts)
        return {Carrier.words: LEVELS, Carrier.effort: efforts}.get(self.carrier, 0)

    def acted_temperature(self, line: CandidateLine) -> float | None:
        """Return the temperature of a request as it reached the model, in [0, 1]; None where none did.

        Of a sentence or an effort it is the middle of the part of [0, 1] that it stands for.
        """
        return line.sent_temperature if line.level is None else (line.level - 0.5) / self.levels

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

    def with_store(self, store: str) -> Self:
        """Return the run with its stores elsewhere; of a bundle's, only where images are made and kept."""
        return replace(self, config=replace(self.config, store=StoreConfig(root=store)))


def read_run(path: Path, store: str | None = None) -> RecordedRun:
    """Read the directory of a finished run; `store` is where its stores lie, if not where the run had them.

    Raises:
        RunError: it does not hold a run, is not finished, or was damaged or edited; the message names the file.
        ConfigError: as `tacevo.results.settings.read_settings`.
    """
    directory = FinishedDirectory(path)
    return finished_run(directory, *read_finished(directory), store)


def finished_run(
    directory: RunDirectory, record: RunRecord, ledger: Sealed[Line], store: str | None = None
) -> RecordedRun:
    """Return a finished run whose run.json and ledger were read, with its archives.

    Raises:
        RunError: as `without_archives`, or an archive is not what the ledger ends with.
        ConfigError: as `read_run`.
    """
    with doubting(record.versions):
        run = without_archives(directory, record, ledger, store)
        archives = read_archives(directory, run.generations[-1])
    networks, prompts = archives
    return replace(run, archives=archives, elites=networks.elites, prompt_trials=prompts.trials)


def without_archives(
    directory: RunDirectory, record: RunRecord, ledger: Sealed[Line], store: str | None = None
) -> RecordedRun:
    """Return a run whose run.json and ledger were read, with empty archives.

    Raises:
        RunError: candidates name others that are not there, or run.json has other settings or texts than the ledger.
        ConfigError: as `tacevo.results.settings.read_settings`.
    """
    check_references(directory.path, record, ledger.lines)
    config = read_settings(directory, record, store)
    run = RecordedRun(directory=directory, record=record, config=config, ledger=ledger)
    rules_of(ledger.lines)
    _check_description(run)
    return run


def descriptors_of(candidate: CandidateLine, scale: Scale, axes: Sequence[str] = PAPER_AXES) -> tuple[float, ...]:
    """Return the descriptors of a trained candidate, EffRatio on a scale, shape (axes,).

    Raises:
        ValueError: the gate rejected the candidate, so nothing was measured.
    """
    brought = iter(candidate.measures)
    values: list[float | None] = [
        getattr(candidate, axis) if axis in PAPER_AXES else next(brought, None) for axis in axes
    ]
    if None in values:
        raise ValueError(f"{candidate.id} was not measured")
    measured = (value for value in values if value is not None)
    return tuple(on_axis(axis, value, scale) for axis, value in zip(axes, measured, strict=True))


def _check_description(run: RecordedRun) -> None:
    """Check that run.json has the configuration, the task and the data of the ledger's first line."""
    differing = [shown(field) for field in differences(run.header.config, to_json(identity(run.config)))]
    if task_hash(run.record.task) != run.header.task:
        differing.append("task")
    if run.record.data != run.header.data:
        differing.append("data")
    if differing:
        raise RunError(
            f"other values of {listed(differing)}",
            place=f"{run.path}/run.json",
            expected="the configuration, the task and the data that the ledger begins with",
            remedy="restore the file",
        )
    if run.facts.groups and are_grouped(to_json(run.config.data), run.task) is False:
        raise RunError(
            counted(run.facts.units, "group"),
            place=f"{run.path}/run.json, data.groups",
            expected="none, as its configuration names none",
        )
