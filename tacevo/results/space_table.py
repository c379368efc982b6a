"""The table of a space: one file with every network of it, its profile and its full training with each of some seeds.

A zip file with a manifest, as published runs have it. Reading compares all members with the manifest, each source with
its hash, and finds each network trained with each seed once. What it does not: whether records follow from each other
(`tacevo.reproduce.space_table`). A judge is a part of the file: a header and trainings of its own, of some of the
networks with fresh seeds. Searches do not look into it, so the digest by which they know a table is that of the rest.

A run that looked its evaluations up in a table knows it by its digest, not by its path: `find_table` finds it.
"""

import hashlib
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import zip_longest
from pathlib import Path
from typing import TypeVar

from tacevo.config.conf_folder import conf_root
from tacevo.config.schema import RunConfig
from tacevo.errors import BundleError, ConfigError, DataError, TacevoError
from tacevo.records import Json, Record, Training, to_json
from tacevo.results.grouped import in_groups
from tacevo.results.table_checks import check_data, check_rows, check_rules, damaged
from tacevo.results.table_header import HEADER, is_table
from tacevo.results.table_records import (
    CARD,
    DECISIVE,
    JUDGE,
    MANIFEST,
    NETWORKS,
    TRAININGS,
    Header,
    SpaceTable,
    TableNetwork,
    TableTraining,
    value_of,
)
from tacevo.storage.canonical import canonical, content_hash, readable
from tacevo.storage.entries import ReadBudget
from tacevo.storage.files import write_durably
from tacevo.storage.zipfiles import MOST_OF_A_MEMBER, packed, read_members
from tacevo.text import as_code, counted, in_markdown
from tacevo.training.full import FullTraining, StoredPredictions
from tacevo.training.metrics import metric_names
from tacevo.typed import parse

T = TypeVar("T", bound=Record)

_MEMBERS = {HEADER, NETWORKS, TRAININGS, CARD, MANIFEST}

#: What a judge adds.
_OF_JUDGE = {f"{JUDGE}{HEADER}", f"{JUDGE}{TRAININGS}"}

_PLACES = re.compile("|".join(map(re.escape, sorted(_MEMBERS | _OF_JUDGE))))


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
            kept=StoredPredictions(predictions=digest, labels=digest),
        ),
    )
    trainings = MOST_OF_A_MEMBER // len(_lines([longest]))
    if networks * len(header.seeds) > trainings:
        raise ConfigError(
            f"{counted(len(header.seeds), 'seed')} of {counted(networks, 'network')}",
            place="--seeds",
            expected=f"at most {counted(trainings, 'training')} of {counted(epochs, 'epoch')}, which a file can hold",
            remedy="lower --seeds or training.epochs",
        )


def check_networks(path: Path, networks: Sequence[TableNetwork]) -> None:
    """Check that a table can hold these networks, which are measured before they are trained.

    Raises:
        BundleError: they are more than a file can hold.
    """
    _check_member(path, NETWORKS, _lines(networks))


def write_table(
    path: Path,
    header: Header,
    networks: Sequence[TableNetwork],
    trainings: Sequence[TableTraining],
    judge: tuple[Header, Sequence[TableTraining]] | None = None,
) -> SpaceTable:
    """Write a table, and read it again; equal rows give equal bytes. Trainings are by network, then by seed.

    Those of a judge are by its networks in the order of `tacevo.results.gene_model`, then by seed; `network` is the row
    in the table.

    Raises:
        StoreError: nothing can be written there.
        BundleError: there are more than a file can hold, or they do not suit each other.
    """
    members = {
        HEADER: readable(to_json(header)).encode(),
        NETWORKS: _lines(networks),
        TRAININGS: _lines(trainings),
        CARD: card(header, networks, judge).encode(),
    }
    if judge is not None:
        members |= {f"{JUDGE}{HEADER}": readable(to_json(judge[0])).encode(), f"{JUDGE}{TRAININGS}": _lines(judge[1])}
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
        raise damaged(path, MANIFEST, "the checksums of the other members", "others")
    if len(found := _OF_JUDGE & members.keys()) == 1:
        missing = sorted(_OF_JUDGE - found)
        raise BundleError(f"a file without {missing[0]}", place=str(path), expected="a judge's header and trainings")
    networks = tuple(_rows(TableNetwork, members, NETWORKS, path))
    judge = _part(path, members, networks, JUDGE) if found else None
    table = replace(_part(path, members, networks), card=members[CARD].decode(errors="replace"), judge=judge)
    _check_text(table, members)
    check_data(table)
    check_rows(table)
    return table


def _part(path: Path, members: Mapping[str, bytes], networks: tuple[TableNetwork, ...], part: str = "") -> SpaceTable:
    """Read the header and the trainings of a table, or of its judge."""
    header = parse(Header, members[f"{part}{HEADER}"], place=f"{path}, {part}{HEADER}", error=BundleError)
    check_rules(path, header, part)
    try:
        settings = header.settings
    except ConfigError as error:
        place, remedy = f"{path}, {part}{HEADER}, config.{error.place}", "another version made it: update tacevo"
        raise BundleError(error.got, place=place, expected=error.expected, remedy=remedy) from error
    return SpaceTable(
        path=path,
        digest=_digest(header, settings, members[NETWORKS], members[f"{part}{TRAININGS}"]),
        header=header,
        networks=networks,
        trainings=tuple(_rows(TableTraining, members, f"{part}{TRAININGS}", path)),
        card="",
        part=part,
    )


def _check_text(table: SpaceTable, members: Mapping[str, bytes]) -> None:
    """Check that each record is written in the one way in which tables have it, so that equal rows have one digest."""
    written = {HEADER: readable(to_json(table.header)).encode()}
    written |= {NETWORKS: _lines(table.networks), TRAININGS: _lines(table.trainings)}
    if (judge := table.judge) is not None:
        written[f"{JUDGE}{HEADER}"] = readable(to_json(judge.header)).encode()
        written[f"{JUDGE}{TRAININGS}"] = _lines(judge.trainings)
    for name, text in written.items():
        if text != members[name]:
            pairs = zip_longest(text.split(b"\n"), members[name].split(b"\n"))
            number = next(number for number, (ours, theirs) in enumerate(pairs, start=1) if ours != theirs)
            raise damaged(table.path, f"{name}, line {number}", "canonical JSON", "the same written otherwise")


def _digest(header: Header, settings: RunConfig, networks: bytes, trainings: bytes) -> str:
    """Hash the rows and what decides them; not who made them, nor settings of searches, nor a judge beside them."""
    return content_hash(
        {
            "made_up": header.made_up,
            "settings": {key: to_json(value_of(settings, key)) for key in DECISIVE},
            "data": to_json(header.data),
            "seeds": header.seeds,
            "rules": to_json(replace(header.rules, core=0)),  # the core trains nothing
            "study": header.study,
            "trivial": header.trivial,
            NETWORKS: _sha256(networks),
            TRAININGS: _sha256(trainings),
        }
    )


def card(
    header: Header,
    networks: Sequence[TableNetwork],
    judge: tuple[Header, Sequence[TableTraining]] | None = None,
) -> str:
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
        f"{'' if judge is None else _said_of(*judge)}"
        "`table.json` holds the configuration, `networks.jsonl` a network a line (genome, source, profile), "
        "`trainings.jsonl` a training a line: losses of each epoch, the epoch of the lowest validation loss and its "
        "test metrics. `tacevo replay FILE --retrain N` trains N rows again, bit for bit.\n\n"
        "What it cannot say: anything of networks outside its space, of other data, or of another recipe. With few "
        "seeds the best network of a table is partly luck.\n"
    )


def _said_of(judge: Header, trainings: Sequence[TableTraining]) -> str:
    """Write what a judge is."""
    judged = counted(len({row.network for row in trainings}), "network")
    config = judge.settings
    return (
        f"Judge: {judged}, those that a model of the genes puts first, trained with {len(judge.seeds)} fresh seeds "
        f"each (numerics {config.numerics.kind}, {config.training.device}), in `judge/`; no search looks them up.\n\n"
        f"Versions of the judge: {_claimed(judge.versions)}\n\nIts machine: {_claimed(judge.machine)}\n\n"
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


#: The directory of tables below a working directory, or a checkout.
TABLES = Path("cache", "tables")


def find_table(recorded: Path, digest: str, beside: Path, named: Path | None = None, *, option: str = "") -> Path:
    """Find the table of a digest.

    Args:
        recorded: where the run had it; of a published run the file's name alone.
        digest: which the run recorded as the fingerprint of its data.
        beside: the directory of a run or a sweep, or the file of a bundle; tables lie beside it.
        named: the file that a user names; no other one is then looked at.
        option: how a user of this command can name it, such as `--table FILE`; empty where it cannot be named.

    Raises:
        DataError: there is none; the message names the file, its digest, and where it was looked for.
        BundleError: what is named is damaged, or is not a table.
    """
    if named is not None:
        if (got := read_table(named).digest) == digest:
            return named
        raise DataError(
            f"one of the digest {got[:12]}",
            place=f"--table {named}",
            expected=f"the table of the digest {digest[:12]}, in which the evaluations were looked up",
        )
    folder = next((parent for parent in Path(str(beside)).parents if parent.is_dir()), Path())
    folders = dict.fromkeys((folder, TABLES, conf_root().parent / TABLES))
    for path in _tables(recorded, folders):
        if _digest_of(path) == digest:
            return path
    looked = f"{recorded}, beside {beside} and in {TABLES}"
    raise DataError(
        f"none, where it was looked for: {looked}",
        place=f"the table {recorded.name}",
        expected=f"the table of the digest {digest}, in which the evaluations were looked up",
        remedy=f"put its file there, under any name that ends in .zip{f', or give {option}' if option else ''}",
    )


def _tables(recorded: Path, folders: Collection[Path]) -> Iterator[Path]:
    """List the files that may be the table, those of its name first."""
    yield from (path for path in (recorded, *(folder / recorded.name for folder in folders)) if path.is_file())
    for folder in folders:
        yield from (path for path in sorted(folder.glob("*.zip")) if path.is_file() and is_table(path))


def _digest_of(path: Path) -> str | None:
    """Return the digest of a table; None of a file that cannot be read as one, which is then not the one."""
    try:
        return read_table(path).digest
    except TacevoError:
        return None
