"""All that the page of a run or a sweep shows, gathered from what was opened."""

import base64
from collections.abc import Callable
from dataclasses import replace

from analysis.report.outputs import outputs
from analysis.report.page.of_run import RunMaterial, read_texts
from analysis.report.page.of_sweep import sweep_contents
from analysis.report.page.sections import sections_contents
from analysis.report.page.whole import PageContents, page_contents, replay_commands
from tacevo.api.runs import Run, remarks_on
from tacevo.api.sweeps import Sweep
from tacevo.bundles.open import Opened
from tacevo.errors import ConfigError, DataError, IncomparableError
from tacevo.parts.registry import needing_parts
from tacevo.storage.notes import read_note
from tacevo.text import plain


def page_of(one: Run | Sweep, name: str, say: Callable[[str], object]) -> tuple[PageContents, list[str]]:
    """Return all that the page of a run or a sweep shows; and what is missing of it, a sentence each.

    Args:
        one: what was opened.
        name: what the user calls it.
        say: is called with each job of a sweep as its tables begin.
    """
    place = one.place
    checked, commands = _checked(place, name), replay_commands(name)
    if isinstance(one, Run):
        shown, missing = _material(one, place, name)
        samples, unseen = _samples_of(one)
        absent = ["no sample images: the data set was not at hand, or was another one"] if unseen else []
        shown = replace(shown, samples=samples, remarks=[*shown.remarks, *absent])
        page = page_contents([shown], title=name, checked=checked, commands=commands)
        return page, [*missing, *unseen]
    materials, missing = [], []
    for number, run in enumerate(one.runs, start=1):
        say(f"job {run.name} ({number} of {len(one.runs)})")
        material, lacks = _material(run, place, name)
        materials.append(material)
        missing += [f"{run.name}: {lack}" for lack in lacks]
    arms = None
    say("the arms, compared")
    try:
        arms, states = sweep_contents(one.collection(), outputs(), missing.append), [*one.left_out]
    except IncomparableError as error:
        states = [f"the arms are not compared: {error}"]
    states = [words.replace(str(place.folder), name) for words in states]
    page = page_contents(materials, sweep=arms, title=name, state="; ".join(states), checked=checked, commands=commands)
    return page, [*missing, *states]


def _material(run: Run, place: Opened, name: str) -> tuple[RunMaterial, list[str]]:
    """Return what the page of a run is made from, and which tables and sections are missing.

    Remarks name the run or the sweep as the page does: where it lay says something about this machine only.
    """
    tables, missing = run.all_tables()
    sections = sections_contents(outputs().sections(run.collection, missing.append), missing.append)
    remarks = [*remarks_on(run), *missing]
    for path, word in ((str(place.folder), name), (str(run.recorded.stores), "its stores")):
        if "/" in path:  # else it names no place beyond the directory that the command was given in
            remarks = [remark.replace(path, word) for remark in remarks]
    notes = [plain(words) for folder in dict.fromkeys((place.folder, run.path)) for words in read_note(folder)]
    texts, edited = read_texts(run.recorded)
    material = RunMaterial(
        collection=run.collection,
        texts=texts,
        edited=edited,
        tables=tables,
        remarks=[*notes, *remarks],
        note=notes,
        sections=sections,
    )
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


def _samples_of(run: Run) -> tuple[str | None, list[str]]:
    """Draw the sample images of a run as a `data:` address; or return the reason why they are missing."""
    try:
        with needing_parts():
            from analysis.figures.style import render  # Matplotlib takes a second to import

            figure = run.figures["samples"]()
    except (ConfigError, DataError) as error:
        return None, [f"no sample images: {error}"]
    return f"data:image/png;base64,{base64.b64encode(render(figure, '.png')).decode('ascii')}", []
