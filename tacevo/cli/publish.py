"""The command `tacevo publish`, and what it and `tacevo replay` need of the analysis.

What they do is imported when they run, so that help is quick.
"""

import argparse
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tacevo.cli.common import DONE, Parser

if TYPE_CHECKING:
    from analysis.report.collection import Collection
    from analysis.report.figure_list import Picture
    from analysis.table import Table
    from tacevo.bundles.open import Opened
    from tacevo.bundles.verify import Verified
    from tacevo.runs.progress import View


def add_publish(commands: "argparse._SubParsersAction[Parser]") -> None:
    """Describe the command."""
    publish = commands.add_parser(
        "publish",
        help="one file with which anybody can replay a run or a sweep",
        description="Replay a finished run or sweep and its studies, and write all that a replay elsewhere needs, with "
        "tables, figures, licence and checksums, into one file: an RO-Crate.",
    )
    publish.add_argument("run", metavar="RUN", help="the folder of a run or of a sweep")
    publish.add_argument(
        "studies", metavar="STUDY", nargs="*", help="the folder of a study of a run (default: all finished ones)"
    )
    publish.add_argument("-o", "--output", required=True, metavar="FILE", help="e.g. run.zip")
    publish.add_argument("--store", metavar="DIR", help="where the stores of the run lie, if they were moved")
    publish.add_argument(
        "--license", default="CC-BY-4.0", metavar="SPDX", help="of what is published (default: CC-BY-4.0)"
    )
    publish.add_argument("--author", action="append", default=[], metavar="NAME", help="may be given several times")
    publish.add_argument("--date", metavar="YYYY-MM-DD", help="of publication (default: the day the run ended)")
    publish.set_defaults(command=_publish, interrupted="nothing was written; the same command begins again")


def verify_bundle(bundle: "Opened", view: "View") -> "Verified":
    """Verify a bundle (`tacevo.bundles.verify`) with the tables of the analysis."""
    from tacevo.bundles.verify import verify

    return verify(bundle, partial(table_files, say=view.say), view)


def in_bundle(verified: "Verified") -> str:
    """Say what of a bundle was compared beside its search and studies, for a person."""
    from tacevo.rules import PAGES

    if all(run.pages == PAGES for run in verified.runs):
        pages = f"summary, costs and {verified.tables} files of tables follow from the records, byte for byte"
    else:
        pages = (
            "costs follow from the records; summary and tables were written by another release, so only their "
            f"checksums were compared: today's tables would differ in {verified.outdated} files, and `tacevo tables` "
            "writes them"
        )
    return (
        f"{pages}; all {verified.entries} store entries were needed\n"
        f"{verified.figures} figures and the pages that describe the bundle: their checksums are right, no more was "
        "compared"
    )


def table_files(folder: Path, store: Path, say: Callable[[str], object]) -> dict[str, bytes]:
    """Make every table of a run or a sweep, from its records and recorded probes alone; give contents by file name.

    Args:
        folder: of the run or the sweep.
        store: of its stores.
        say: is told why a sweep has no tables of its arms.
    """
    return _of_sweep(folder, store, say)[0] if _is_sweep(folder) else _tables(_collect(folder, store), store)


def pages(folder: Path, store: Path, say: Callable[[str], object]) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Make every table, as `table_files`, and every figure that follows from the records; give contents by name."""
    from analysis.report.collection import pictures_of

    if _is_sweep(folder):
        tables, pictures = _of_sweep(folder, store, say)
        return tables, _drawn(pictures)
    found = _collect(folder, store)
    return _tables(found, store), _drawn(pictures_of(found))


def _is_sweep(folder: Path) -> bool:
    from tacevo.storage.sweep_directory import SweepDirectory

    return SweepDirectory(folder).is_one


def _of_sweep(
    folder: Path, store: Path, say: Callable[[str], object]
) -> "tuple[dict[str, bytes], tuple[Picture, ...]]":
    """Make the tables and list the figures of a sweep; one whose jobs are no comparison has none of arms."""
    from analysis.report.sweep_collection import collect_sweep, pictures_of, tables_of
    from analysis.runs.run import load_run
    from analysis.tables.published import beside_published
    from tacevo.bundles.open import located
    from tacevo.errors import IncomparableError

    beside = beside_published([load_run(run) for run in located(folder).runs])
    try:
        found = collect_sweep(folder, store)
    except IncomparableError as error:  # e.g. budgets that differ; the runs themselves have been replayed
        reason = str(error).replace(str(folder), "the sweep")  # which may lie in a private folder
        say(f"no table or figure compares the arms: {reason}")
        return _files([beside]), ()
    return _files([beside, *tables_of(found)]), pictures_of(found)


def _tables(found: "Collection", store: Path) -> dict[str, bytes]:
    from analysis.report.collection import tables_of
    from tacevo.runs.profiles import recall_profiles

    return _files(tables_of(found, recall_profiles(found.run.path, str(store))))


def _files(tables: "Iterable[Table]") -> dict[str, bytes]:
    from analysis.tables.rendering import table_texts

    return {name: text.encode() for table in tables for name, text in table_texts(table).items()}


def _drawn(pictures: "Iterable[Picture]") -> dict[str, bytes]:
    from analysis.figures.style import render

    return {f"{picture.name}.pdf": render(picture.draw(), ".pdf") for picture in pictures}


def _publish(options: argparse.Namespace) -> int:
    from rich.console import Console

    from tacevo.bundles.publish import Request, publish
    from tacevo.runs.progress import PlainView
    from tacevo.text import counted

    request = Request(
        run=Path(options.run),
        studies=tuple(map(Path, options.studies)),
        store=None if options.store is None else Path(options.store),
        licence=options.license,
        authors=tuple(options.author),
        published=options.date,
    )
    with PlainView(Console(stderr=True)) as view:
        done = publish(request, Path(options.output), make_pages=partial(pages, say=view.say), view=view)
    print(f"published: {options.output} ({counted(done.files, 'file')}, {done.size / 1e6:.2f} MB)")
    print(f"{done.what}: {done.content}")
    print(f"bundle digest: {done.digest}")
    return DONE


def _collect(run: Path, store: Path) -> "Collection":
    from analysis.report.collection import collect

    return collect(run, store)
