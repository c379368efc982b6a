"""The commands that draw what runs found: `tacevo figures | report | paper | ablations`."""

import argparse
import base64
import contextlib
import itertools
import shlex
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from analysis.figures.style import render
from analysis.report.collection import side_by_side, with_largest_studies
from analysis.report.document import ENGINES, Chapter, make_pdf, write_chapter, write_document
from analysis.report.figure_list import Picture, pictures_of, sweep_pictures, undrawn, write_pictures
from analysis.report.following import follow
from analysis.report.page.contents import PageContents
from analysis.report.page.html import as_html
from analysis.report.page.of_run import RunMaterial, read_texts
from analysis.report.page.of_sweep import sweep_contents
from analysis.report.page.whole import page_contents, replay_commands
from analysis.report.sweep_collection import SweepCollection, collect_sweep, sweep_tables
from analysis.report.writing import remove_outdated
from analysis.sweeps.metrics import TESTS
from tacevo.api.runs import Run
from tacevo.bundles.open import Opened, opened
from tacevo.cli.common import DONE, RUN, Parser, existing_store, output_directory, place_of_results
from tacevo.cli.tables import finish, gather, place_of, remarks_on, say, show, status_of, with_published
from tacevo.environment import as_typed
from tacevo.errors import ConfigError, DataError, IncomparableError
from tacevo.results.study_reading import check_alike
from tacevo.runs.data_check import samples_of_run
from tacevo.runs.progress import Progress
from tacevo.storage.files import write_durably
from tacevo.storage.notes import read_note
from tacevo.text import listed

_FORMATS = ("pdf", "svg", "png")


def add_figures(parser: Parser) -> None:
    """Describe `tacevo figures`."""
    parser.description = "Draw every figure of a finished run and its studies."
    parser.add_argument("run", metavar="RUN", help=RUN)
    parser.add_argument(
        "-o", "--output", metavar="DIR", help="where to write them (default for a directory: RUN/figures)"
    )
    parser.add_argument(
        "--format", nargs="+", choices=_FORMATS, default=_FORMATS, help="of the files (default: all three)"
    )
    finish(parser, _figures)


def add_report(parser: Parser) -> None:
    """Describe `tacevo report`."""
    parser.description = (
        "Write one HTML file with which a finished run and its studies, or a finished sweep, can be looked into."
    )
    parser.add_argument("run", metavar="RUN", help="the directory or bundle of a run or a sweep")
    parser.add_argument(
        "--follow",
        action="store_true",
        help="write it again while searches are at work, until they are finished; the page reloads itself",
    )
    parser.add_argument(
        "-o", "--output", metavar="FILE", help="file to write (default for a directory: RUN/report.html)"
    )
    finish(parser, _report)


def add_paper(parser: Parser) -> None:
    """Describe `tacevo paper`."""
    parser.description = (
        "Write every table and figure of finished runs and their studies, a LaTeX document that holds them all, and "
        "its PDF where LaTeX is installed."
    )
    parser.add_argument("runs", metavar="RUN", nargs="+", help=RUN)
    parser.add_argument(
        "-o", "--output", metavar="DIR", default="build/paper", help="directory to write to (default: build/paper)"
    )
    finish(parser, _paper)


def add_ablations(parser: Parser) -> None:
    """Describe `tacevo ablations`."""
    parser.description = (
        "Compare the arms of a sweep by its finished jobs: print tables, and write them as .tex, .md and .csv, with "
        "figures as .pdf."
    )
    parser.add_argument("sweep", metavar="DIR", help="the directory or bundle of a sweep")
    parser.add_argument(
        "-o", "--output", metavar="OUT", help="where to write them (default for a directory: DIR/ablations)"
    )
    parser.add_argument(
        "--reference", metavar="ARM", help="the arm to compare with (default: the one that the sweep states, or none)"
    )
    finish(parser, _ablations)


def _figures(options: argparse.Namespace) -> int:
    place = place_of(options, "figures")
    gathered = gather(options.run, options.store)
    directory = output_directory(place)
    pictures, remarks = _pictures(gathered)
    endings = [f".{name}" for name in dict.fromkeys(options.format)]
    with _shown("figures", len(pictures)) as on_drawn:
        write_pictures(pictures, directory, endings, on_drawn)
    names, every = {picture.name for picture in pictures}, [f".{name}" for name in _FORMATS]
    say([*remarks, *remove_outdated(directory, names, task=gathered.collection.run.task, endings=every)])
    print(f"figures: {directory}")
    return status_of(gathered)


def _report(options: argparse.Namespace) -> int:
    path, source = place_of(options, "report.html"), Path(options.run)
    store, name = existing_store(options.store), source.resolve().name
    if source.parent.is_file():
        name = f"{source.parent.name}/{name}"
    if options.follow and source.is_dir():
        print(f"report: {path}", flush=True)
        follow(source, path, None if store is None else Path(store))
    place = opened(source)
    gathered = [Run(place, place.read(run, store)) for run in place.runs]
    if place.jobs is None:
        page, missing = page_of_run(gathered[0], place, name)
    else:
        page, missing = page_of_sweep(gathered, place, name, store)
    write_durably(path, as_html(page))
    say([*(remark for one in gathered if status_of(one) for remark in remarks_on(one)), *missing])
    print(f"report: {path}")
    return max(map(status_of, gathered))


def _paper(options: argparse.Namespace) -> int:
    gathered = [_for_paper(gather(run, options.store)) for run in options.runs]
    found = [one.collection for one in gathered]
    _check_names([one.run.name for one in found])
    check_alike([compared.study for one in found for compared in one.studies])
    directory = output_directory(options.output)
    published = with_published([one.run for one in found])
    chapters = [write_chapter("The paper beside these runs", published, [], directory / "published")]
    beside, alone = side_by_side(found)
    say(alone)
    if beside:
        chapters.append(write_chapter("These searches beside each other", beside, [], directory / "searches"))
    # LaTeX reads no file whose name holds certain characters, so runs are numbered.
    chapters += [_chapter(one, directory / f"run{number}") for number, one in enumerate(gathered, start=1)]
    document = write_document(chapters, directory)
    print(f"document: {document}")
    pdf = make_pdf(document, shutil.which)
    engines = " or ".join(command[0] for command, _ in ENGINES)
    print(f"PDF: {pdf}" if pdf else f"no PDF: install {engines}, and run the same command again")
    return max(map(status_of, gathered))


def _check_names(names: Sequence[str]) -> None:
    """Check that the runs have different names, which distinguish their pages."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(
            f"{listed(twice)} twice", place="tacevo paper", expected="runs with different directory names"
        )


def _for_paper(gathered: Run) -> Run:
    """Keep one study of a run on each data set, and print which are passed over."""
    chosen = gathered.collection = with_largest_studies(gathered.collection)
    say(
        f"passed over: {compared.name}; the paper takes the run's largest study on each data set"
        for compared in chosen.passed_over
    )
    return gathered


def _chapter(gathered: Run, directory: Path) -> Chapter:
    """Write the tables and figures of a run into a directory."""
    name = gathered.collection.run.name
    tables, missing = gathered.all_tables()
    pictures, undrawn = _pictures(gathered)
    with _shown(name, len(pictures)) as on_drawn:
        chapter = write_chapter(name, tables, pictures, directory, on_drawn)
    say([*missing, *undrawn])
    return chapter


def _pictures(gathered: Run) -> tuple[list[Picture], list[str]]:
    """List the pictures of a run, sample images first; or the reason why they are missing."""
    run = gathered.collection.run
    pictures, missing = list(pictures_of(gathered.collection)), list(undrawn(run))
    try:
        figure = samples_of_run(run.path, gathered.recorded.config.store.root, Console(stderr=True))
    except (ConfigError, DataError) as error:
        return pictures, [*missing, f"no sample images: {error}"]
    caption = f"Training images of the data set ({run.name})."
    return [Picture(name=f"samples_{run.task}", caption=caption, draw=lambda: figure), *pictures], missing


@contextlib.contextmanager
def _shown(words: str, total: int) -> Iterator[Callable[[str], None]]:
    """Show how many pictures are drawn, on a terminal."""
    number = itertools.count(1)
    with Progress() as view:
        yield lambda name: view.advance(words, next(number), total)


def _ablations(options: argparse.Namespace) -> int:
    store = existing_store(options.store)
    place = place_of_results(options.output, options.sweep, "ablations", "the tables and figures of a published sweep")
    found = _collected_sweep(Path(options.sweep), None if store is None else Path(store), options.reference)
    directory = output_directory(place)
    show(sweep_tables(found), directory)
    pictures = {picture.name: picture for picture in sweep_pictures(found)}
    write_pictures(pictures.values(), directory, [".pdf"], lambda name: print(f"{name}.pdf: {pictures[name].caption}"))
    say(f"missing: {missing.job.name}: {missing.reason}" for missing in found.sweep.missing)
    say(f"without a test score: {missing.job.name}: {missing.reason}" for missing in found.sweep.untested)
    if found.found.primary in TESTS.values() and found.sweep.terms.retraining is None:
        print(f"next:   {as_typed('tacevo')} study sweep={shlex.quote(options.sweep)}")
    print(f"tables and figures: {directory}")
    return DONE


def _collected_sweep(path: Path, store: Path | None, reference: str | None) -> SweepCollection:
    """Read a sweep from a directory or a bundle, a bundle with its own stores unless others are named."""
    if path.is_dir():
        return collect_sweep(path, store, reference)
    published = opened(path)
    return collect_sweep(published.folder, store or published.store, reference)


def page_of_run(gathered: Run, place: Opened, name: str) -> tuple[PageContents, list[str]]:
    """Return all that the page of a run shows, and what is missing of it.

    Args:
        gathered: the run.
        place: where it lies.
        name: what the user calls it.
    """
    shown, missing = _material(gathered, place, name)
    samples, unseen = _samples_of(gathered.collection.run.path, gathered.recorded.config.store.root)
    absent = ["no sample images: the data set was not at hand, or was another one"] if unseen else []
    shown = replace(shown, samples=samples, remarks=[*shown.remarks, *absent])
    page = page_contents([shown], title=name, checked=_checked(place, name), commands=replay_commands(name))
    return page, [*missing, *unseen]


def page_of_sweep(runs: Sequence[Run], place: Opened, name: str, store: str | None) -> tuple[PageContents, list[str]]:
    """Return all that the page of a sweep shows, and what is missing: of a run, or why its arms are not compared.

    Args:
        runs: of its jobs, in their order.
        place: the sweep.
        name: what the user calls it.
        store: the directory of the stores that the user named, if any.
    """
    materials, missing = zip(*(_material(one, place, name) for one in runs), strict=True)
    sweep, state = None, ""
    try:
        known = {one.collection.run.path.name: one.collection.run for one in runs}
        found = collect_sweep(place.folder, place.store if store is None else Path(store), known=known)
        sweep = sweep_contents(found)
    except IncomparableError as error:
        state = f"the arms are not compared: {str(error).replace(str(place.folder), name)}"
    page = page_contents(
        materials,
        sweep=sweep,
        title=name,
        state=state,
        checked=_checked(place, name),
        commands=replay_commands(name),
    )
    of_runs = [f"{one.name}: {lack}" for one, lacks in zip(runs, missing, strict=True) for lack in lacks]
    return page, [*of_runs, *([state] if state else [])]


def _material(gathered: Run, place: Opened, name: str) -> tuple[RunMaterial, list[str]]:
    """Return what the page of a run is made from, and which tables are missing.

    Remarks name the run or the sweep as the page does: where it lay says something about this machine only.
    """
    found = gathered.collection
    tables, missing = gathered.all_tables()
    remarks = [*remarks_on(gathered), *missing]
    for path, word in ((str(place.folder), name), (str(gathered.recorded.stores), "its stores")):
        if "/" in path:  # else it names no place beyond the directory that the command was given in
            remarks = [remark.replace(path, word) for remark in remarks]
    notes = [words for folder in dict.fromkeys((place.folder, found.run.path)) for words in read_note(folder)]
    material = RunMaterial(found=found, recorded=read_texts(found.run), tables=tables, remarks=[*notes, *remarks])
    return material, missing


def _checked(place: Opened, name: str) -> list[str]:
    """Say what `tacevo report` compared of the run or the sweep of a name, with what, and what it did not."""
    sealed = "A directory has no manifest; nothing else of it was compared."
    if place.digest is not None:
        digest = f"The manifest's SHA-256 is the bundle's digest: {place.digest}."
        sealed = f"Every file of {name.partition('/')[0]} is as its manifest says. {digest}"
    return [
        "`tacevo report` compared the records with each other. It searched, trained and tested nothing again.",
        "Each ledger: every line has the hash of the line before it, and the last hash is the digest in run.json.",
        "Settings and texts in run.json, both archives, the niches: as the ledger has them.",
        "A source is shown only if its hash is that of its ledger line; sample images only if their data have the "
        "ledger's fingerprint.",
        "Each study shown: its scores are such a chain, too, and the last hash is the digest in study.json.",
        sealed,
        "No ledger holds rejected answers, times, costs, versions, machine, confinement: these stand as recorded.",
        "The first command above searches again from the recorded answers, probes and trainings, and compares every "
        "ledger line, both archives, every candidate's file and every score. The second also trains five networks.",
    ]


def _samples_of(run: Path, store: str) -> tuple[str | None, list[str]]:
    """Draw the sample images of a run as a `data:` address; or return the reason why they are missing."""
    try:
        figure = samples_of_run(run, store, Console(stderr=True))
    except (ConfigError, DataError) as error:
        return None, [f"no sample images: {error}"]
    return f"data:image/png;base64,{base64.b64encode(render(figure, '.png')).decode('ascii')}", []
