"""The tables and figures of a bundle, as `tacevo publish` writes them and a replay makes them again."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from analysis.report.collection import Collection, collection_of, compared_studies, tables_of
from analysis.report.sweep_collection import SweepCollection, collect_sweep, sweep_tables
from analysis.report.writing import table_files as files_of
from analysis.table import Table
from analysis.tables.published import beside_published
from tacevo.bundles.verify import Rerun
from tacevo.errors import IncomparableError
from tacevo.runs.profiles import recall_profiles
from tacevo.storage.sweep_directory import SweepDirectory


def table_files(directory: Path, runs: Sequence[Rerun], say: Callable[[str], object]) -> dict[str, bytes]:
    """Make every table of a run or a sweep from its records and recorded probes; return contents by file name.

    `say` is called with the reason if a sweep has no tables of its arms.
    """
    say("making the tables again")
    if SweepDirectory(directory).is_one:
        return _of_sweep(directory, runs, say)[0]
    (done,) = runs
    return _files(tables_of(_collected(done), recall_profiles(done.run)))


def pages(
    directory: Path, runs: Sequence[Rerun], say: Callable[[str], object]
) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Make every table, as `table_files`, and every figure that follows from the records; return contents by name."""
    say("making tables and figures")
    from analysis.figures.style import render  # Matplotlib takes a second to import, and a replay draws nothing
    from analysis.report.figure_list import pictures_of, sweep_pictures

    if SweepDirectory(directory).is_one:
        tables, swept = _of_sweep(directory, runs, say)
        pictures = () if swept is None else sweep_pictures(swept)
    else:
        (done,) = runs
        found = _collected(done)
        tables = _files(tables_of(found, recall_profiles(done.run)))
        pictures = pictures_of(found)
    return tables, {f"{picture.name}.pdf": render(picture.draw(), ".pdf") for picture in pictures}


def _collected(done: Rerun) -> Collection:
    """Gather a run that was run again, with its studies."""
    return collection_of(done.run, compared_studies(done.run, done.studies.values()))


def _of_sweep(
    directory: Path, runs: Sequence[Rerun], say: Callable[[str], object]
) -> tuple[dict[str, bytes], SweepCollection | None]:
    """Make the tables of a sweep, and read what its figures show; without a fair comparison there are none of arms."""
    shown = [done.run for done in runs]
    beside, known = beside_published(shown), {run.path.name: run for run in shown}
    try:
        found = collect_sweep(directory, runs[0].run.stores, known=known)
    except IncomparableError as error:  # e.g. budgets that differ; the runs themselves have been replayed
        reason = str(error).replace(str(directory), "the sweep")
        say(f"no table or figure compares the arms: {reason}")
        return _files([beside]), None
    return _files([beside, *sweep_tables(found)]), found


def _files(tables: Iterable[Table]) -> dict[str, bytes]:
    return {name: text.encode() for name, text in files_of(tables).items()}
