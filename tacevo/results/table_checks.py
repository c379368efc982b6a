"""Check that the records of a table agree: known rules, equal data, each row once, possible scores.

Whether they follow from something else, a space or a training, is looked at by `tacevo.reproduce.space_table`.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

from tacevo.choices import Device
from tacevo.config.sources import DEVICE
from tacevo.config.task_texts import contract_of
from tacevo.errors import BundleError, ConfigError
from tacevo.records import Json, to_json
from tacevo.results.table_header import HEADER
from tacevo.results.table_records import JUDGE, NETWORKS, TRAININGS, Header, SpaceTable, TableTraining
from tacevo.rules import CURRENT, FIRST_STUDY, KEPT_SINCE, LIKE_TODAY, STUDY, Rules
from tacevo.training.full import FullTraining
from tacevo.training.metrics import contradiction, metric_names


def check_like_today(table: SpaceTable) -> None:
    """Check that what is trained today stands beside the rows of a table: rules alike made both.

    Raises:
        ConfigError: other rules made the table.
    """
    for part, known in LIKE_TODAY.items():
        number = getattr(table.header.rules, part)
        if number not in known:
            place, remedy = f"{table.path}, rules.{part}", "`tacevo tabulate` makes a table under the rules of today"
            expected = f"{', '.join(map(str, sorted(known)))}, which are like those of this version"
            raise ConfigError(str(number), place=place, expected=expected, remedy=remedy)


def check_rules(path: Path, header: Header, part: str = "") -> None:
    """Check that this version knows the numbers of all rules, be they older ones."""
    names = [field.name for field in fields(Rules)]
    rules = {name: (1, getattr(CURRENT, name), getattr(header.rules, name)) for name in names}
    for name, (first, last, number) in {**rules, "study": (FIRST_STUDY, STUDY, header.study)}.items():
        if not first <= number <= last:
            place, expected = f"{path}, {part}{HEADER}, rules of {name}", f"a number from {first} to {last}"
            remedy = "another version made it: update tacevo"
            raise BundleError(str(number), place=place, expected=expected, remedy=remedy)


def check_data(table: SpaceTable) -> None:
    """Check that data, task and configuration say the same of what they share."""
    header, facts = table.header, table.header.data
    settings, contract = header.settings, header.task.contract
    try:
        wanted = contract_of(settings.task, facts)
    except ConfigError as error:
        raise damaged(table.path, f"{HEADER}, data", error.got, error.expected) from error
    for what, got, expected in (
        ("task.name", header.task.name, settings.task.name),
        ("task.contract", to_json(contract), to_json(wanted)),
        ("data.image_size", facts.image_size, settings.data.image_size),
        ("data.names", len(facts.names), facts.outputs),
    ):
        if got != expected:
            raise damaged(table.path, f"{HEADER}, {what}", f"{expected}, by the configuration and the data", f"{got}")
    if _is_negative(header.trivial):
        raise damaged(table.path, f"{HEADER}, trivial", "0 or more", str(header.trivial))


def check_rows(table: SpaceTable) -> None:
    """Check that each network is there once with its hash, and each of its trainings, of the epochs of the header."""
    networks, header, path = table.networks, table.header, table.path
    if len(set(header.seeds)) < len(header.seeds):
        raise damaged(path, f"{HEADER}, seeds", "different seeds", f"{list(header.seeds)}")
    for row, network in enumerate(networks):
        place = f"{NETWORKS}, line {row + 1}"
        if network.sha256 != hashlib.sha256(network.source.encode()).hexdigest():
            raise damaged(path, place, "the SHA-256 of the source", network.sha256[:12])
        if (network.profile is None) == (network.rejection is None):
            raise damaged(path, place, "a profile or a rejection", "both or neither")
    if len(table.by_source) < len(networks):
        raise damaged(path, NETWORKS, "each source once", "one twice")
    _check_trainings(table, [row for row, network in enumerate(networks) if network.profile is not None])
    if table.judge is not None:
        _check_judge(table, table.judge)
    _check_seeds_differ(table)
    _check_tests_agree(table)
    _check_networks_differ(table)


def _check_trainings(table: SpaceTable, rows: Sequence[int]) -> None:
    """Check that the networks of these rows, and no others, have a sound training with each seed, in order."""
    wanted = [(row, seed) for row in rows for seed in range(len(table.header.seeds))]
    if [(row.network, row.seed) for row in table.trainings] != wanted:
        place = f"{table.part}{TRAININGS}"
        raise damaged(table.path, place, "each admitted network with each seed once, in order", "other rows")
    for place, training in _placed(table):
        if (training.full is None) == (training.rejection is None):
            raise damaged(table.path, place, "a training or a rejection", "both or neither")
        if training.full is not None:
            _check_training(table, training.full, place)


def _check_judge(table: SpaceTable, judge: SpaceTable) -> None:
    """Check that a judge is of the same data and recipe, and of seeds and networks of which it has all trainings.

    A judge may be trained on another device, with its numerics: it tells losses, which no search looks up.
    """
    ours, theirs = table.header, judge.header
    for what in ("made_up", "task", "data", "trivial"):
        if getattr(ours, what) != getattr(theirs, what):
            raise damaged(table.path, f"{JUDGE}{HEADER}, {what}", "as the table has it", "another")
    settings = replace(theirs.settings, executor=ours.settings.executor)
    for group, _, name in (key.partition(".") for key in DEVICE if "." in key):
        of_table = {name: getattr(getattr(ours.settings, group), name)}
        settings = replace(settings, **{group: replace(getattr(settings, group), **of_table)})
    if settings != ours.settings:
        raise damaged(table.path, f"{JUDGE}{HEADER}, config", "the settings of the table, but for its device", "others")
    if len(theirs.seeds) < 2 or len({*ours.seeds, *theirs.seeds}) < len(ours.seeds) + len(theirs.seeds):
        place, expected = f"{JUDGE}{HEADER}, seeds", "two or more different seeds, none of the table's"
        raise damaged(table.path, place, expected, f"{list(theirs.seeds)}")
    rows = judge.trained
    if not rows or any(row >= len(table.networks) or table.networks[row].profile is None for row in rows):
        raise damaged(table.path, f"{JUDGE}{TRAININGS}", "admitted networks of the table", "others, or none")
    _check_trainings(judge, rows)


def _placed(*tables: SpaceTable | None) -> Iterator[tuple[str, TableTraining]]:
    """Yield each training with its place in the file."""
    for table in tables:
        for number, row in enumerate(() if table is None else table.trainings, start=1):
            assert table is not None
            yield f"{table.part}{TRAININGS}, line {number}", row


def _check_training(table: SpaceTable, full: FullTraining, place: str) -> None:
    """Check that a training has the epochs of the header, and that nothing of it contradicts the rest."""
    path, facts, settings = table.path, table.header.data, table.header.settings.training
    epochs = settings.epochs
    losses, of_training = full.training.validation_losses, full.training.train_losses
    if not len(losses) == len(of_training) == epochs:
        raise damaged(path, place, f"the losses of {epochs} epochs", str(len(losses)))
    if not min(losses + of_training) >= 0:
        raise damaged(path, place, "losses of 0 or more", str(min(losses + of_training)))
    if any(map(_is_negative, losses)) or any(value == 0 and _is_negative(value) for value in full.metrics.values()):
        raise damaged(path, place, "0 without a sign", "-0.0")
    if full.training.not_deterministic and settings.device is Device.cpu:
        got = f"operations that are not deterministic ({', '.join(full.training.not_deterministic)})"
        raise damaged(path, place, "none on a CPU, where such a network is rejected", got)
    if full.kept is None and table.header.study >= KEPT_SINCE:
        raise damaged(path, place, f"test predictions, which study rules {table.header.study} keep", "none")
    if full.epoch != losses.index(min(losses)) + 1:
        raise damaged(path, place, "the epoch of the lowest validation loss", str(full.epoch))
    if full.metrics.keys() != (names := metric_names(facts.kind, facts.names)):
        raise damaged(path, f"{place}, metrics", ", ".join(sorted(names)), ", ".join(sorted(full.metrics)))
    found = contradiction(facts.kind, facts.names, full.metrics, full.confusion, images=facts.counts[2])
    if found is not None:
        what, got, expected = found
        raise damaged(path, f"{place}, {what}", expected, got)


def _check_seeds_differ(table: SpaceTable) -> None:
    """Check that no training of a network stands for two seeds: other initial weights give other weights."""
    seen: set[tuple[int, str]] = set()
    for place, row in _placed(table, table.judge):
        if row.full is None:
            continue
        key = row.network, row.full.training.weights_sha256
        if key in seen:
            raise damaged(table.path, place, "other weights than those of another seed", "the same")
        seen.add(key)


def _check_tests_agree(table: SpaceTable) -> None:
    """Check that all trainings were tested on the same labels: their digest, and the images of each true class."""
    first: Json = None
    for place, row in _placed(table, table.judge):
        if row.full is None:
            continue
        labels = None if row.full.kept is None else row.full.kept.labels
        tested: Json = [labels, [sum(images) for images in row.full.confusion or ()]]
        first = tested if first is None else first
        if tested != first:
            raise damaged(table.path, place, f"the test labels of the rows above, {first}", f"{tested}")


def _check_networks_differ(table: SpaceTable) -> None:
    """Check that networks of different sizes have neither weights nor predictions in common."""
    sizes: dict[str, int] = {}
    for place, row in _placed(table, table.judge):
        profile = table.networks[row.network].profile
        if row.full is None or profile is None:
            continue
        kept, training = row.full.kept, row.full.training
        for digest in (training.weights_sha256, training.predictions_sha256, *([kept.predictions] if kept else [])):
            if sizes.setdefault(digest, profile.parameters) != profile.parameters:
                expected = "other weights and predictions than a network's above"
                raise damaged(table.path, place, f"{expected} that has another number of parameters", "the same")


def _is_negative(value: float) -> bool:
    """Answer whether a number has a minus sign, be it that of -0.0."""
    return math.copysign(1, value) < 0


def damaged(path: Path, place: str, expected: str, got: str) -> BundleError:
    """Return the error of a table in which something does not agree, with the member and its place."""
    return BundleError(got, place=f"{path}, {place}", expected=expected, remedy="fetch the file again")
