"""The whole page: its runs, their sources, and a sweep's arms."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from analysis.report.page.of_run import RunMaterial, run_contents, run_sources


@dataclass(frozen=True, slots=True, kw_only=True)
class PageContents:
    """Everything that the page shows; `page.html` holds it as JSON, and its script draws it."""

    title: str
    #: Of a running search; the page then reloads itself.
    live: bool = False
    #: A sentence on how the search stands, of a live page.
    state: str = ""
    #: As `run_contents`; at least one, but for a live page of a search that has only begun.
    runs: tuple[dict[str, Any], ...]
    #: As `sweep_contents`; None of a single run.
    sweep: dict[str, Any] | None = None
    #: As `run_sources`, by hash; runs of a sweep share many.
    sources: Mapping[str, dict[str, Any]]
    #: What was checked before this was written, a sentence each; and the commands that check the rest.
    checked: Sequence[str]
    commands: Sequence[str] = ()


def page_contents(runs: Sequence[RunMaterial], **fields: Any) -> PageContents:
    """Return all that the page shows of runs; `fields` are the others of `PageContents`."""
    sources: dict[str, dict[str, Any]] = {}
    for one in runs:
        sources |= run_sources(one.collection.run, one.texts)
    return PageContents(runs=tuple(map(run_contents, runs)), sources=sources, **fields)


def replay_commands(name: str) -> list[str]:
    """Return the commands that replay a run or a sweep of a name, and train some of its networks again."""
    return [f"tacevo replay {shlex.quote(name)}", f"tacevo replay {shlex.quote(name)} --retrain 5"]
