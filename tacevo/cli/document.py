"""The command `tacevo report --latex`: a document of several runs and sweeps."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from analysis.report.collection import side_by_side, with_largest_studies
from analysis.report.document import ENGINES, make_pdf, write_chapter, write_document
from tacevo.api.runs import Run
from tacevo.api.sweeps import Sweep
from tacevo.cli.common import output_directory, tell
from tacevo.cli.figures import drawable, progress_of
from tacevo.cli.tables import open_all, remarks_of, say, status_of, with_published
from tacevo.results.study import check_alike
from tacevo.runs.progress import Progress


def run_document(names: Sequence[str], output: str, store: str | None) -> int:
    """Write the LaTeX document of runs and sweeps: the paper beside the runs, these beside each other, then each."""
    shown = open_all(names, store)
    runs = [_with_largest(one) for one in shown if isinstance(one, Run)]
    collections = [one.collection for one in runs]
    check_alike([compared.study for one in collections for compared in one.studies])
    directory = output_directory(output)
    chapters = [write_chapter("The paper beside these runs", with_published(runs), [], directory / "published")]
    beside, alone = side_by_side(collections)
    say(alone)
    if beside:
        chapters.append(write_chapter("These searches beside each other", beside, [], directory / "searches"))
    # LaTeX reads no file whose name holds certain characters, so runs are numbered.
    chapters += [_chapter(one, directory / f"run{number}") for number, one in enumerate(shown, start=1)]
    document = write_document(chapters, directory)
    tell(f"document: {document}")
    with Progress():
        pdf = make_pdf(document, shutil.which)
    engines = " or ".join(command[0] for command, _ in ENGINES)
    tell(f"PDF: {pdf}" if pdf else f"no PDF: install {engines}, and run the same command again")
    return max(map(status_of, shown))


def _with_largest(run: Run) -> Run:
    """Keep one study of a run on each data set, and print which are passed over."""
    chosen = run.collection = with_largest_studies(run.collection)
    say(
        f"passed over: {compared.name}; the document takes the run's largest study on each data set"
        for compared in chosen.passed_over
    )
    return run


def _chapter(one: Run | Sweep, directory: Path) -> str:
    """Write the tables and figures of a run or a sweep into a directory."""
    say(remarks_of(one))
    with Progress() as view:
        view.say(f"making the tables of {one.name}")
        tables, missing = one.all_tables()
    pictures, undrawn = drawable(one)
    with progress_of(f"figures of {one.name}", len(pictures)) as on_drawn:
        chapter = write_chapter(one.name, tables, pictures, directory, on_drawn=on_drawn, say=missing.append)
    say(dict.fromkeys([*missing, *undrawn]))
    return chapter
