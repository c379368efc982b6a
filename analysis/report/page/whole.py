"""The whole page: its runs, their sources, and a sweep's arms."""

import shlex
from collections.abc import Sequence

from analysis.report.page.contents import PageContents, Source, SweepContents
from analysis.report.page.of_run import RunMaterial, run_contents, run_sources


def page_contents(
    runs: Sequence[RunMaterial],
    *,
    title: str,
    checked: Sequence[str],
    commands: Sequence[str],
    sweep: SweepContents | None = None,
    state: str = "",
    live: bool = False,
) -> PageContents:
    """Return all that the page shows; the arguments are the fields of `PageContents`."""
    sources: dict[str, Source] = {}
    for one in runs:
        sources |= run_sources(one.found.run, one.recorded.texts)
    return PageContents(
        title=title,
        live=live,
        state=state,
        runs=tuple(map(run_contents, runs)),
        sweep=sweep,
        sources=sources,
        checked=tuple(checked),
        commands=tuple(commands),
    )


def replay_commands(name: str) -> list[str]:
    """Return the commands that replay a run or a sweep of a name, and train some of its networks again."""
    return [f"tacevo replay {shlex.quote(name)}", f"tacevo replay {shlex.quote(name)} --retrain 5"]
