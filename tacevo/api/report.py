"""All that the page of a run or a sweep shows, gathered from what was opened."""

import base64
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from analysis.report.page.of_run import RunMaterial, read_texts
from analysis.report.page.of_sweep import sweep_contents
from analysis.report.page.whole import PageContents, page_contents, replay_commands
from analysis.report.sweep_collection import collect_sweep
from tacevo.api.runs import Run, remarks_on
from tacevo.bundles.open import Opened, over_runs
from tacevo.errors import ConfigError, DataError, IncomparableError
from tacevo.results.run import RecordedRun
from tacevo.runs.data_check import samples_of_run
from tacevo.storage.notes import read_note

#: A run, what its page is made from, and which tables are missing.
Gathered = tuple[Run, RunMaterial, list[str]]


def gather(place: Opened, name: str, store: str | None, say: Callable[[str], object]) -> list[Gathered]:
    """Read every run of what was opened, with its tables.

    Remarks name the run or the sweep as the page does: where it lay says something about this machine only.

    Args:
        place: where it lies.
        name: what the user calls it.
        store: the directory of the stores that the user named, if any.
        say: is called with each job of a sweep as it begins.
    """
    return list(over_runs(place, lambda path: _gathered(Run(place, place.read(path, store)), place, name), say))


def page_of_run(gathered: Gathered, place: Opened, name: str) -> tuple[PageContents, list[str]]:
    """Return all that the page of a run shows, and what is missing of it; arguments as of `gather`."""
    run, shown, missing = gathered
    samples, unseen = _samples_of(run.recorded)
    absent = ["no sample images: the data set was not at hand, or was another one"] if unseen else []
    shown = replace(shown, samples=samples, remarks=[*shown.remarks, *absent])
    page = page_contents([shown], title=name, checked=_checked(place, name), commands=replay_commands(name))
    return page, [*missing, *unseen]


def page_of_sweep(
    gathered: Sequence[Gathered], place: Opened, name: str, store: str | None
) -> tuple[PageContents, list[str]]:
    """Return all that the page of a sweep shows, and what is missing: of a run, or why its arms are not compared.

    Arguments are as of `gather`.
    """
    sweep, state = None, ""
    try:
        known = {run.path.name: run.recorded for run, _, _ in gathered}
        found = collect_sweep(place.folder, place.store if store is None else Path(store), known=known)
        sweep = sweep_contents(found)
    except IncomparableError as error:
        state = f"the arms are not compared: {str(error).replace(str(place.folder), name)}"
    page = page_contents(
        [material for _, material, _ in gathered],
        sweep=sweep,
        title=name,
        state=state,
        checked=_checked(place, name),
        commands=replay_commands(name),
    )
    of_runs = [f"{run.name}: {lack}" for run, _, missing in gathered for lack in missing]
    return page, [*of_runs, *([state] if state else [])]


def _gathered(run: Run, place: Opened, name: str) -> Gathered:
    tables, missing = run.all_tables()
    remarks = [*remarks_on(run), *missing]
    for path, word in ((str(place.folder), name), (str(run.recorded.stores), "its stores")):
        if "/" in path:  # else it names no place beyond the directory that the command was given in
            remarks = [remark.replace(path, word) for remark in remarks]
    notes = [words for folder in dict.fromkeys((place.folder, run.path)) for words in read_note(folder)]
    texts, edited = read_texts(run.recorded)
    material = RunMaterial(found=run.collection, texts=texts, edited=edited, tables=tables, remarks=[*notes, *remarks])
    return run, material, missing


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


def _samples_of(run: RecordedRun) -> tuple[str | None, list[str]]:
    """Draw the sample images of a run as a `data:` address; or return the reason why they are missing."""
    from analysis.figures.style import render  # Matplotlib takes a second to import

    try:
        figure = samples_of_run(run.config, run.facts, Console(stderr=True))
    except (ConfigError, DataError) as error:
        return None, [f"no sample images: {error}"]
    return f"data:image/png;base64,{base64.b64encode(render(figure, '.png')).decode('ascii')}", []
