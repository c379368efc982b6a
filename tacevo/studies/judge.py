"""`tacevo judge`: the networks that a model of the genes puts first, trained with seeds that no search has seen.

The seeds of a table choose, in searches and by its own order; a network that they put first is partly lucky. These only
judge. The trainings are those of studies, in the same store, so several processes can share them, each a part, and one
that was stopped goes on where it was. The table gets its judge when all trainings are there, and never a part of it.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from tacevo.config.compose import compose, compose_elsewhere
from tacevo.config.schema import RunConfig
from tacevo.config.sources import DEVICE
from tacevo.errors import ConfigError, telling
from tacevo.records import Mode
from tacevo.results.gene_model import put_first
from tacevo.results.space_table import check_size, read_table, write_table
from tacevo.results.table_checks import check_like_today
from tacevo.results.table_header import is_table
from tacevo.results.table_records import SpaceTable, failures_of
from tacevo.runs.datasets import load_same
from tacevo.runs.progress import Progress
from tacevo.runs.seeds import judge_seed
from tacevo.runs.wiring import Workbench, check_means, started_ahead
from tacevo.studies.tabulate import header_of, train_rows
from tacevo.text import counted

#: The groups of settings that say where trainings run, and where they are kept.
_HERE = ("executor", "store")


class Judged(NamedTuple):
    """What became of the trainings of a judge, or of a part of them."""

    #: A line for each that failed.
    failures: Sequence[str]
    #: The table with its judge; None of a part.
    table: SpaceTable | None = None


def judge_table(
    table: SpaceTable,
    overrides: Sequence[str],
    target: Path,
    view: Progress,
    *,
    networks: int,
    seeds: int,
    number: int = 0,
    parts: int = 1,
) -> Judged:
    """Train the judge of a table, or a part of it; write the table with its judge where that is whole.

    Args:
        table: a verified one.
        overrides: settings of device, executor and store; all others are the table's.
        target: the file to write, which may be the table's own; a judge that stands there is replaced only by one that
            holds its networks and seeds.
        view: shows the progress.
        networks: how many are judged.
        seeds: of each, at least 2.
        number: of the part, in [0, parts).
        parts: 1 for the whole judge.

    Raises:
        ConfigError: the table is made up, has fewer networks to judge or other rules than today's; or an override sets
            anything else; or the target holds another table, or a judge with other networks or seeds.
        BundleError: the target is a damaged table.
        TacevoError: see its subclasses; what was computed so far is kept.
        KeyboardInterrupt: the user stopped it; the same command continues.
    """
    header = table.header
    if header.made_up:
        raise ConfigError("a made-up table", place=str(table.path), expected="one whose networks were trained")
    check_like_today(table)
    if seeds < 2:
        raise ConfigError(
            str(seeds), place="--seeds", expected="at least 2, of which one judges what the others choose"
        )
    rows = put_first(table, networks)
    if len(rows) < networks:
        expected = f"at most {len(rows)}, which trained with every seed and have a genome"
        raise ConfigError(str(networks), place="--networks", expected=expected)
    fresh = tuple(judge_seed(header.settings.seed, each) for each in range(seeds))
    _check_target(target, table, rows, fresh)
    config = judging(header.settings, overrides)
    check_means(config)
    with started_ahead(config) as started:
        data = load_same(config, header.data, view)
        with Workbench(config, header.task, data.facts, Mode.record, data=data, say=view.say, started=started) as bench:
            made = replace(header_of(config, header.task, header.data, header.trivial, seeds=seeds), seeds=fresh)
            check_size(made, networks)
            with telling(lambda: True):  # whatever has ended is in the stores
                judged = {row: table.networks[row] for row in rows}
                trainings = train_rows(bench, fresh, judged, data, view, number=number, parts=parts)
    failures = failures_of(trainings)
    if parts > 1:
        return Judged(failures)
    return Judged(failures, write_table(target, header, table.networks, table.trainings, (made, trainings)))


def _check_target(target: Path, table: SpaceTable, rows: Sequence[int], fresh: Sequence[int]) -> None:
    """Check that no other table is lost where this one is written, nor a judge of other networks or seeds."""
    if not target.is_file() or not is_table(target):
        return
    there, remedy = read_table(target), "name another file with -o"
    if there.digest != table.digest:
        got, expected = f"another table, of the digest {there.digest[:12]}", "a new file, or one of the same table"
        raise ConfigError(got, place=f"-o {target}", expected=expected, remedy=remedy)
    old = there.judge
    if old is not None and not (set(old.trained) <= set(rows) and set(old.header.seeds) <= set(fresh)):
        expected = f"a judge that holds the one there: {counted(len(old.trained), 'network')}, "
        expected += f"{counted(len(old.header.seeds), 'seed')}, or more"
        got = f"{counted(len(rows), 'network')}, {counted(len(fresh), 'seed')}"
        raise ConfigError(got, place=f"-o {target}", expected=expected, remedy=remedy)


def judging(made: RunConfig, overrides: Sequence[str]) -> RunConfig:
    """Lay settings of this machine over the configuration of a table.

    Raises:
        ConfigError: one sets anything else.
    """
    keys = [override.partition("=")[0] for override in overrides]
    here = [override for override, key in zip(overrides, keys, strict=True) if key.partition(".")[0] in _HERE]
    device = [override for override, key in zip(overrides, keys, strict=True) if key in DEVICE]
    for override, key in zip(overrides, keys, strict=True):
        if override not in here and override not in device:
            expected = f"settings of {', '.join(_HERE)}, or {', '.join(DEVICE)}: all others are the table's"
            raise ConfigError(override, place=key, expected=expected)
    chosen = compose(here)
    return replace(compose_elsewhere(made, device), **{group: getattr(chosen, group) for group in _HERE})
