"""What the page of `tacevo report` holds beside the contents of its runs."""

import base64
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from analysis.figures.style import render
from analysis.report.collection import Collection
from analysis.report.page.contents import PageContents
from analysis.report.page.of_run import RunMaterial, read_recorded
from analysis.report.page.of_sweep import sweep_contents
from analysis.report.page.whole import page_contents, replay_commands
from analysis.report.sweep_collection import collect_sweep
from tacevo.bundles.open import Opened
from tacevo.errors import ConfigError, DataError, IncomparableError
from tacevo.runs.data_check import samples_of_run


def page_of_sweep(runs: Sequence[Collection], place: Opened, name: str) -> tuple[PageContents, list[str]]:
    """Return all that the page of a sweep shows, and why its arms are not compared, if they are not.

    Args:
        runs: of its jobs, in their order.
        place: the sweep.
        name: what the user calls it.
    """
    shown = [
        RunMaterial(found=one, recorded=read_recorded(one.run), remarks=[*one.run.not_sent.values()]) for one in runs
    ]
    sweep, missing = None, []
    try:
        sweep = sweep_contents(collect_sweep(place.folder, place.store))
    except IncomparableError as error:
        missing.append(f"the arms are not compared: {str(error).replace(str(place.folder), name)}")
    page = page_contents(
        shown, sweep=sweep, title=name, state="".join(missing), checked=checked(place, name), commands=replay_commands(name)
    )
    return page, missing


def checked(place: Opened, name: str) -> list[str]:
    """Say what reading a run or a sweep has checked of it."""
    sealed = [f"Every byte of {name} is what its manifest says (bundle digest {place.digest})."] if place.digest else []
    return [
        *sealed,
        "Each ledger is a whole chain that ends with the digest, both archives are those of its last generation, and "
        "every source shown has the hash of its line.",
        "Nothing was computed again; the commands above do that.",
    ]


def samples_of(run: Path, store: str | None) -> tuple[str | None, list[str]]:
    """Draw the sample images of a run as a `data:` address; or return the reason why they are missing."""
    try:
        figure = samples_of_run(run, store, Console(stderr=True))
    except (ConfigError, DataError) as error:
        return None, [f"no sample images: {error}"]
    return f"data:image/png;base64,{base64.b64encode(render(figure, '.png')).decode('ascii')}", []
