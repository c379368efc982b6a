"""The table of a space: one file with every network of it, its profile and its full training with each of some seeds.

A zip file with a manifest, as published runs have it. Reading compares all members with the manifest, each source with
its hash, and finds each network trained with each seed once. What it does not: whether records follow from each other
(`tacevo.reproduce.space_table`).
"""

import hashlib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from annotated_types import Ge, MinLen

from tacevo.choices import Device
from tacevo.config.plain import from_plain
from tacevo.config.schema import RunConfig
from tacevo.config.task_texts import contract_of
from tacevo.errors import BundleError, ConfigError, TacevoError
from tacevo.profile import Profile
from tacevo.records import DataFacts, Json, Record, Rejection, Task, Training, to_json
from tacevo.results.grouped import in_groups
from tacevo.rules import CURRENT, FIRST_STUDY, KEPT_SINCE, STUDY, Rules
from tacevo.storage.canonical import canonical, content_hash, readable
from tacevo.storage.entries import ReadBudget
from tacevo.storage.files import write_durably
from tacevo.storage.zipfiles import MOST_OF_A_MEMBER, names_in, packed, read_members
from tacevo.text import as_code, counted, in_markdown
from tacevo.training.full import FullTraining, Kept
from tacevo.training.metrics import contradiction, metric_names
from tacevo.typed import FreeJson, parse

T = TypeVar("T", bound=Record)

HEADER, NETWORKS, TRAININGS, CARD, MANIFEST = (
    "table.json",
    "networks.jsonl",
    "trainings.jsonl",
    "README.md",
    "manifest.sha256",
)

#: What decides the rows, beside the data, the seeds and the rules; as keys of the configuration.
DECISIVE = (
    "data.image_size",
    "gate.max_modules",
    "gate.max_flops",
    "gate.max_parameters",
    "llm.space",
    "numerics.kind",
    "task.class_name",
    "task.kind",
    "task.loss",
    "task.output_argument",
    "task.outputs",
    "task.target_scaling",
    "training.batch_size",
    "training.device",
    "training.gpu",
    "training.learning_rate",
    "training.precision",
)

_MEMBERS = {HEADER, NETWORKS, TRAININGS, CARD, MANIFEST}

_PLACES = re.compile("|".join(map(re.escape, sorted(_MEMBERS))))


@dataclass(frozen=True, slots=True, kw_only=True)
class Header(Record):
    """What all rows follow from."""

    #: Layout of the file.
    schema: Literal[1] = 1
    #: Whether no network was trained: what stands in place of trainings was drawn, to measure the tools by.
    made_up: bool
    #: As `tacevo.records.to_json` writes it: the space is `llm.space`, a training is `training`.
    config: dict[str, FreeJson]
    task: Task
    data: DataFacts
    #: Of the trainings.
    seeds: Annotated[tuple[int, ...], MinLen(1)]
    rules: Rules
    #: Number of the rules of full trainings (`tacevo.rules.STUDY`).
    study: int
    #: Of the validation images (`tacevo.training.losses`).
    trivial: Annotated[float, Ge(0)]
    versions: dict[str, str]
    machine: dict[str, FreeJson]

    @property
    def settings(self) -> RunConfig:
        """The configuration.

        Raises:
            ConfigError: this version does not know it.
        """
        return from_plain(self.config)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableNetwork(Record):
    """A network of the table."""

    #: Value of each gene; None of the task's baseline, whose file is not written by the grammar.
    genome: dict[str, bool | int | float | str] | None
    source: str
    #: SHA-256 of the source.
    sha256: str
    #: Exactly one of these two is there: what the gate measured, or why it refused the network.
    profile: Profile | None = None
    rejection: Rejection | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TableTraining(Record):
    """A network trained with one seed."""

    #: Row of the network, and of the seed in the header; from 0.
    network: Annotated[int, Ge(0)]
    seed: Annotated[int, Ge(0)]
    #: Exactly one of these two is there.
    full: FullTraining | None = None
    rejection: Rejection | None = None

    @property
    def verdict(self) -> FullTraining | Rejection:
        """What came of it."""
        verdict = self.full or self.rejection
        assert verdict is not None  # as reading checks
        return verdict


@dataclass(frozen=True, kw_only=True, eq=False)
class SpaceTable:
    """A table that was read; each network that the gate admitted has a training with each seed."""

    path: Path
    #: Of the rows and what decides them, so that equal rows are equal data of a search.
    digest: str
    header: Header
    networks: tuple[TableNetwork, ...]
    #: By network, then by seed.
    trainings: tuple[TableTraining, ...]
    #: The text of its README.
    card: str

    @cached_property
    def by_source(self) -> Mapping[str, int]:
        """The row of each source."""
        return {network.source: row for row, network in enumerate(self.networks)}

    @cached_property
    def verdicts(self) -> Mapping[tuple[int, int], FullTraining | Rejection]:
        """What came of each training, by the rows of network and seed."""
        return {(row.network, row.seed): row.verdict for row in self.trainings}

    @property
    def name(self) -> str:
        """What it is of, in a line."""
        header = self.header
        what = "MADE UP, not trained: " if header.made_up else ""
        seeds = counted(len(header.seeds), "seed")
        return f"{what}{counted(len(self.networks), 'network')} for {header.task.name}, {seeds} each"

    @property
    def failures(self) -> list[str]:
        """What was refused by the gate or failed to train, a line each."""
        refused = [
            f"network {row}: {network.rejection.reason}"
            for row, network in enumerate(self.networks)
            if network.rejection is not None
        ]
        failed = [
            f"network {row.network}, seed {row.seed}: {row.rejection.reason}"
            for row in self.trainings
            if row.rejection is not None
        ]
        return refused + failed

    @property
    def failed(self) -> str:
        """How many networks the gate refused and how many trainings failed, in a line; none, too, is said."""
        refused = sum(network.rejection is not None for network in self.networks)
        failed = sum(row.rejection is not None for row in self.trainings)
        return f"the gate refused {counted(refused, 'network')}, and {counted(failed, 'training')} failed"


def value_of(config: RunConfig, key: str) -> object:
    """Return the value of one of `DECISIVE`."""
    group, _, name = key.partition(".")
    return getattr(getattr(config, group), name)


def is_table(path: Path) -> bool:
    """Answer whether a file is a zip file with the header of a table; it is not verified."""
    return HEADER in (names_in(path) or ())


def check_size(header: Header, networks: int) -> None:
    """Check that the trainings of so many networks can be read again, however long their numbers are.

    Raises:
        ConfigError: it could pass what a reader takes.
    """
    epochs, classes = header.settings.training.epochs, header.task.contract.outputs
    long, digest = 1 / 3 * 1e-100, "0" * 64
    training = Training(
        train_losses=(long,) * epochs,
        validation_losses=(long,) * epochs,
        predictions_sha256=digest,
        weights_sha256=digest,
    )
    most = sum(header.data.counts)
    longest = TableTraining(
        network=networks,
        seed=len(header.seeds),
        full=FullTraining(
            training=training,
            epoch=epochs,
            metrics=dict.fromkeys(metric_names(header.data.kind, header.data.names), long),
            confusion=((most,) * classes,) * classes,
            kept=Kept(predictions=digest, labels=digest),
        ),
    )
    trainings = MOST_OF_A_MEMBER // len(_lines([longest]))
    if networks * len(header.seeds) > trainings:
        raise ConfigError(
            f"training.seeds={len(header.seeds)} of {counted(networks, 'network')}",
            place="training.seeds",
            expected=f"at most {counted(trainings, 'training')} of {counted(epochs, 'epoch')}, which a file can hold",
            remedy="lower training.seeds or training.epochs",
        )


def check_networks(path: Path, networks: Sequence[TableNetwork]) -> None:
    """Check that a table can hold these networks, which are measured before they are trained.

    Raises:
        BundleError: they are more than a file can hold.
    """
    _check_member(path, NETWORKS, _lines(networks))


def write_table(
    path: Path, header: Header, networks: Sequence[TableNetwork], trainings: Sequence[TableTraining]
) -> SpaceTable:
    """Write a table, and read it again; equal rows give equal bytes. Trainings are by network, then by seed.

    Raises:
        StoreError: nothing can be written there.
        BundleError: there are more than a file can hold, or they do not suit each other.
    """
    members = {
        HEADER: readable(to_json(header)).encode(),
        NETWORKS: _lines(networks),
        TRAININGS: _lines(trainings),
        CARD: card(header, networks).encode(),
    }
    manifest = "".join(f"{_sha256(data)}  {name}\n" for name, data in sorted(members.items()))
    for name, data in members.items():  # before the file is written, so that what stands there stays
        _check_member(path, name, data)
    write_durably(path, packed({**members, MANIFEST: manifest.encode()}))
    return read_table(path)


def _check_member(path: Path, name: str, data: bytes) -> None:
    if len(data) > MOST_OF_A_MEMBER:
        expected = f"at most {MOST_OF_A_MEMBER} bytes of {name}, which a file can hold"
        raise BundleError(str(len(data)), place=str(path), expected=expected)


def read_table(path: Path) -> SpaceTable:
    """Read a table, and compare its members with its manifest; one that was read before and stands as it did is shared.

    Raises:
        BundleError: it is damaged or is another file, or a network or a training is missing.
    """
    try:
        status = path.stat()
    except OSError as error:
        remedy = "that of the project lies in its checkout, below cache/tables; `tacevo tabulate` makes others"
        got = error.strerror or "nothing"
        raise BundleError(got, place=str(path), expected="the table of a space", remedy=remedy) from error
    return _read(path.resolve(), status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=2)
def _read(path: Path, _: int, size: int) -> SpaceTable:
    try:
        members = read_members(path, _PLACES, ReadBudget(path, size))
    except TacevoError as error:
        expected = "the table of a space, as `tacevo tabulate` writes it"
        raise BundleError(error.got, place=error.place, expected=expected, remedy=error.remedy) from error
    if missing := sorted(_MEMBERS - members.keys()):
        raise BundleError(f"a file without {', '.join(missing)}", place=str(path), expected="the table of a space")
    manifest = members.pop(MANIFEST)
    if manifest.decode(errors="replace") != "".join(f"{_sha256(members[n])}  {n}\n" for n in sorted(members)):
        raise _damaged(path, MANIFEST, "the checksums of the other members", "others")
    header = parse(Header, members[HEADER], place=f"{path}, {HEADER}", error=BundleError)
    _check_rules(path, header)
    try:
        settings = header.settings
    except ConfigError as error:
        place, remedy = f"{path}, {HEADER}, config.{error.place}", "another version made it: update tacevo"
        raise BundleError(error.got, place=place, expected=error.expected, remedy=remedy) from error
    table = SpaceTable(
        path=path,
        digest=_digest(header, settings, members),
        header=header,
        networks=tuple(_rows(TableNetwork, members, NETWORKS, path)),
        trainings=tuple(_rows(TableTraining, members, TRAININGS, path)),
        card=members[CARD].decode(errors="replace"),
    )
    _check_text(table, members)
    _check_data(table)
    _check_rows(table)
    return table


def _check_rules(path: Path, header: Header) -> None:
    """Check that this version knows the numbers of all rules, be they older ones."""
    parts = [field.name for field in fields(Rules)]
    rules = {part: (1, getattr(CURRENT, part), getattr(header.rules, part)) for part in parts}
    for part, (first, last, number) in {**rules, "study": (FIRST_STUDY, STUDY, header.study)}.items():
        if not first <= number <= last:
            place, expected = f"{path}, {HEADER}, rules of {part}", f"a number from {first} to {last}"
            remedy = "another version made it: update tacevo"
            raise BundleError(str(number), place=place, expected=expected, remedy=remedy)


def _check_text(table: SpaceTable, members: Mapping[str, bytes]) -> None:
    """Check that each record is written in the one way in which tables have it, so that equal rows have one digest."""
    written = {HEADER: readable(to_json(table.header)).encode()}
    written |= {NETWORKS: _lines(table.networks), TRAININGS: _lines(table.trainings)}
    for name, text in written.items():
        if text != members[name]:
            pairs = zip_longest(text.split(b"\n"), members[name].split(b"\n"))
            number = next(number for number, (ours, theirs) in enumerate(pairs, start=1) if ours != theirs)
            raise _damaged(table.path, f"{name}, line {number}", "canonical JSON", "the same written otherwise")


def _check_data(table: SpaceTable) -> None:
    """Check that data, task and configuration say the same of what they share."""
    header, facts = table.header, table.header.data
    settings, contract = header.settings, header.task.contract
    try:
        wanted = contract_of(settings.task, facts)
    except ConfigError as error:
        raise _damaged(table.path, f"{HEADER}, data", error.got, error.expected) from error
    for what, got, expected in (
        ("task.name", header.task.name, settings.task.name),
        ("task.contract", to_json(contract), to_json(wanted)),
        ("data.image_size", facts.image_size, settings.data.image_size),
        ("data.names", len(facts.names), facts.outputs),
    ):
        if got != expected:
            raise _damaged(table.path, f"{HEADER}, {what}", f"{expected}, by the configuration and the data", f"{got}")
    if _is_negative(header.trivial):
        raise _damaged(table.path, f"{HEADER}, trivial", "0 or more", str(header.trivial))


def _digest(header: Header, settings: RunConfig, members: Mapping[str, bytes]) -> str:
    """Hash the rows and what decides them; not who made them, nor settings of searches."""
    return content_hash(
        {
            "made_up": header.made_up,
            "settings": {key: to_json(value_of(settings, key)) for key in DECISIVE},
            "data": to_json(header.data),
            "seeds": header.seeds,
            "rules": to_json(replace(header.rules, core=0)),  # the core trains nothing
            "study": header.study,
            "trivial": header.trivial,
            **{name: _sha256(members[name]) for name in (NETWORKS, TRAININGS)},
        }
    )


def _check_rows(table: SpaceTable) -> None:
    """Check that each network is there once with its hash, and each of its trainings, of the epochs of the header."""
    networks, header, path = table.networks, table.header, table.path
    if len(set(header.seeds)) < len(header.seeds):
        raise _damaged(path, f"{HEADER}, seeds", "different seeds", f"{list(header.seeds)}")
    for row, network in enumerate(networks):
        place = f"{NETWORKS}, line {row + 1}"
        if network.sha256 != _sha256(network.source.encode()):
            raise _damaged(path, place, "the SHA-256 of the source", network.sha256[:12])
        if (network.profile is None) == (network.rejection is None):
            raise _damaged(path, place, "a profile or a rejection", "both or neither")
    if len(table.by_source) < len(networks):
        raise _damaged(path, NETWORKS, "each source once", "one twice")
    wanted = [
        (row, seed)
        for row, network in enumerate(networks)
        if network.profile is not None
        for seed in range(len(header.seeds))
    ]
    if [(row.network, row.seed) for row in table.trainings] != wanted:
        raise _damaged(path, TRAININGS, "each admitted network with each seed once, in order", "other rows")
    for number, training in enumerate(table.trainings, start=1):
        place = f"{TRAININGS}, line {number}"
        if (training.full is None) == (training.rejection is None):
            raise _damaged(path, place, "a training or a rejection", "both or neither")
        if training.full is not None:
            _check_training(table, training.full, place)
    _check_seeds_differ(table)
    _check_tests_agree(table)
    _check_networks_differ(table)


def _check_training(table: SpaceTable, full: FullTraining, place: str) -> None:
    """Check that a training has the epochs of the header, and that nothing of it contradicts the rest."""
    path, facts, settings = table.path, table.header.data, table.header.settings.training
    epochs = settings.epochs
    losses, of_training = full.training.validation_losses, full.training.train_losses
    if not len(losses) == len(of_training) == epochs:
        raise _damaged(path, place, f"the losses of {epochs} epochs", str(len(losses)))
    if not min(losses + of_training) >= 0:
        raise _damaged(path, place, "losses of 0 or more", str(min(losses + of_training)))
    if any(map(_is_negative, losses)) or any(value == 0 and _is_negative(value) for value in full.metrics.values()):
        raise _damaged(path, place, "0 without a sign", "-0.0")
    if full.training.not_deterministic and settings.device is Device.cpu:
        got = f"operations that are not deterministic ({', '.join(full.training.not_deterministic)})"
        raise _damaged(path, place, "none on a CPU, where such a network is rejected", got)
    if full.kept is None and table.header.study >= KEPT_SINCE:
        raise _damaged(path, place, f"test predictions, which study rules {table.header.study} keep", "none")
    if full.epoch != losses.index(min(losses)) + 1:
        raise _damaged(path, place, "the epoch of the lowest validation loss", str(full.epoch))
    if full.metrics.keys() != (names := metric_names(facts.kind, facts.names)):
        raise _damaged(path, f"{place}, metrics", ", ".join(sorted(names)), ", ".join(sorted(full.metrics)))
    found = contradiction(facts.kind, facts.names, full.metrics, full.confusion, images=facts.counts[2])
    if found is not None:
        what, got, expected = found
        raise _damaged(path, f"{place}, {what}", expected, got)


def _check_seeds_differ(table: SpaceTable) -> None:
    """Check that no training of a network stands for two seeds: other initial weights give other weights."""
    seen: set[tuple[int, str]] = set()
    for number, row in enumerate(table.trainings, start=1):
        if row.full is None:
            continue
        key = row.network, row.full.training.weights_sha256
        if key in seen:
            place = f"{TRAININGS}, line {number}"
            raise _damaged(table.path, place, "other weights than those of another seed", "the same")
        seen.add(key)


def _check_tests_agree(table: SpaceTable) -> None:
    """Check that all trainings were tested on the same labels: their digest, and the images of each true class."""
    first: Json = None
    for number, row in enumerate(table.trainings, start=1):
        if row.full is None:
            continue
        labels = None if row.full.kept is None else row.full.kept.labels
        tested: Json = [labels, [sum(images) for images in row.full.confusion or ()]]
        first = tested if first is None else first
        if tested != first:
            place = f"{TRAININGS}, line {number}"
            raise _damaged(table.path, place, f"the test labels of the rows above, {first}", f"{tested}")


def _check_networks_differ(table: SpaceTable) -> None:
    """Check that networks of different sizes have neither weights nor predictions in common."""
    sizes: dict[str, int] = {}
    for number, row in enumerate(table.trainings, start=1):
        profile = table.networks[row.network].profile
        if row.full is None or profile is None:
            continue
        kept, training = row.full.kept, row.full.training
        for digest in (training.weights_sha256, training.predictions_sha256, *([kept.predictions] if kept else [])):
            if sizes.setdefault(digest, profile.parameters) != profile.parameters:
                place, expected = f"{TRAININGS}, line {number}", "other weights and predictions than a network's above"
                raise _damaged(table.path, place, f"{expected} that has another number of parameters", "the same")


def _is_negative(value: float) -> bool:
    """Answer whether a number has a minus sign, be it that of -0.0."""
    return math.copysign(1, value) < 0


def card(header: Header, networks: Sequence[TableNetwork]) -> str:
    """Write what a table is of, how it was made, and what it cannot say."""
    config, (train, validation, test) = header.settings, header.data.counts
    training, refused = config.training, sum(network.rejection is not None for network in networks)
    seeds = counted(len(header.seeds), "seed")
    kept = {
        key: value
        for key, value in to_json(config.data).items()
        if value is not None and value is not False and value != []
    }
    made = (
        "**This table is MADE UP.** No network was trained: its losses were drawn at random, to measure tools by. "
        "Nothing about networks follows from it.\n\n"
        if header.made_up
        else ""
    )
    return (
        f"# {'MADE-UP table' if header.made_up else 'Table'} of a space: {in_markdown(header.task.name)}\n\n{made}"
        f"{len(networks)} networks, {refused} of them refused by the gate; the others trained for {training.epochs} "
        f"epochs with each of {seeds} (batches of {training.batch_size}, Adam, learning rate "
        f"{training.learning_rate:g}, numerics {config.numerics.kind}, {training.device}).\n\n"
        f"Data: {train} images train, {validation} validate, {test} test{in_groups(header.data)}, "
        f"{header.data.image_size} px; fingerprint {in_markdown(header.data.fingerprint)}.\n\n    {canonical(kept)}\n\n"
        f"Space (`llm.space`):\n\n    {canonical(None if config.llm.space is None else to_json(config.llm.space))}\n\n"
        f"Versions: {_claimed(header.versions)}\n\nMachine: {_claimed(header.machine)}\n\n"
        "`table.json` holds the configuration, `networks.jsonl` a network a line (genome, source, profile), "
        "`trainings.jsonl` a training a line: losses of each epoch, the epoch of the lowest validation loss and its "
        "test metrics. `tacevo replay FILE --retrain N` trains N rows again, bit for bit.\n\n"
        "What it cannot say: anything of networks outside its space, of other data, or of another recipe. With few "
        "seeds the best network of a table is partly luck.\n"
    )


def _claimed(values: Mapping[str, Json]) -> str:
    """Write claims of a table's maker: as the first tables have them, or as code where Markdown would obey a part."""
    parts = [canonical(part) for part in (*values, *values.values())]
    text = canonical(values)
    return text if all(in_markdown(part) == part for part in parts) else as_code(text)


def _lines(rows: Iterable[Record]) -> bytes:
    return "".join(f"{canonical(_without_none(to_json(row)))}\n" for row in rows).encode()


def _without_none(row: Json) -> Json:
    """Leave out what a row does not have, but for a baseline's genome."""
    assert isinstance(row, dict)
    return {name: value for name, value in row.items() if value is not None or name == "genome"}


def _rows(kind: type[T], members: Mapping[str, bytes], name: str, path: Path) -> Iterable[T]:
    for number, line in enumerate(members[name].removesuffix(b"\n").split(b"\n") if members[name] else [], start=1):
        yield parse(kind, line, place=f"{path}, {name}, line {number}", error=BundleError)


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _damaged(path: Path, place: str, expected: str, got: str) -> BundleError:
    return BundleError(got, place=f"{path}, {place}", expected=expected, remedy="fetch the file again")
