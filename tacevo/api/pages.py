"""The tables and figures of a bundle, as `tacevo publish` writes them and a replay makes them again."""

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path, PurePath

from analysis.report.collection import Collection, collection_of, compared_studies, tables_of
from analysis.report.outputs import outputs
from analysis.report.sweep_collection import SweepCollection, collect_sweep, sweep_tables
from analysis.report.writing import INDEX
from analysis.report.writing import table_files as files_of
from analysis.table import Table
from tacevo.bundles.verify import Rerun
from tacevo.errors import ConfigError, IncomparableError
from tacevo.runs.profiles import recall_profiles
from tacevo.storage.sweep_directory import SweepDirectory


def table_files(directory: Path, runs: Sequence[Rerun], say: Callable[[str], object]) -> dict[str, bytes]:
    """Make every table of a run or a sweep from its records and recorded probes; return contents by file name.

    `say` is called with what is at work, and with the reason if a sweep has no tables of its arms.
    """
    say("making the tables again")
    return _tables(directory, runs, say)[0]


def can_make(name: str) -> bool:
    """Answer whether a file of tables of a bundle can be made here: the part that makes it may not be installed."""
    known = outputs(ours=True)
    if not known.missing:
        return True
    path = PurePath(name)
    return path.name != INDEX and known.makes(re.sub(r"_\d+$", "", path.stem))


def pages(
    directory: Path, runs: Sequence[Rerun], say: Callable[[str], object]
) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Make every table, as `table_files`, and every figure that follows from the records; return contents by name."""
    say("making tables and figures")
    for reason in outputs(ours=True).missing.values():
        expected = "all tables of tacevo, which anybody can then compare"
        raise ConfigError(reason, place="a bundle", expected=expected)
    from analysis.figures.style import render  # Matplotlib takes a second to import, and a replay draws nothing
    from analysis.report.figure_list import pictures_of, sweep_pictures

    tables, shown = _tables(directory, runs, say)
    if shown is None:
        return tables, {}
    pictures = sweep_pictures(shown) if isinstance(shown, SweepCollection) else pictures_of(shown)
    return tables, {f"{picture.name}.pdf": render(picture.draw(), ".pdf") for picture in pictures}


def _tables(
    directory: Path, runs: Sequence[Rerun], say: Callable[[str], object]
) -> tuple[dict[str, bytes], Collection | SweepCollection | None]:
    """Make the tables, and return what figures show, too; without a fair comparison a sweep has neither of its arms."""
    if not SweepDirectory(directory).is_one:
        (done,) = runs
        shown = collection_of(done.run, compared_studies(done.run, done.studies.values()))
        return _files(tables_of(shown, recall_profiles(done.run))), shown
    known = {done.run.path.name: done.run for done in runs}
    beside = outputs(ours=True).beside(list(known.values()), say)
    try:
        swept = collect_sweep(directory, runs[0].run.stores, known=known)
    except IncomparableError as error:  # e.g. budgets that differ; the runs themselves have been replayed
        reason = str(error).replace(str(directory), "the sweep")
        say(f"no table or figure compares the arms: {reason}")
        return _files(beside), None
    return _files([*beside, *sweep_tables(swept)]), swept


def _files(tables: Iterable[Table]) -> dict[str, bytes]:
    return {name: text.encode() for name, text in files_of(tables).items()}
