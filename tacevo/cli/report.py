"""The command `tacevo report`: a page to look into a run or a sweep, or a LaTeX document of several runs."""

import argparse
from functools import partial
from pathlib import Path

from tacevo.api.runs import Run
from tacevo.api.sweeps import Sweep
from tacevo.cli.common import existing_store, place_of_results, tell
from tacevo.cli.tables import open_all, remarks_of, say, status_of
from tacevo.runs.progress import Progress
from tacevo.storage.files import write_durably


def run_report(options: argparse.Namespace) -> int:
    """Write a page or a document."""
    if options.latex:
        from tacevo.cli.document import run_document

        return run_document(options)
    from analysis.report.page.html import as_html
    from tacevo.api.page import page_of

    path, source = place_of_results(options, "report.html"), Path(options.runs[0])
    store, name = existing_store(options.store), source.resolve().name
    if source.parent.is_file():
        name = f"{source.parent.name}/{name}"
    if options.follow and source.is_dir():
        from analysis.report.following import follow

        tell(f"report: {path}", flush=True)
        follow(source, path, None if store is None else Path(store), partial(tell, flush=True))
    (one,) = open_all(options.runs, store)
    with Progress() as view:
        page, missing = page_of(one, name, view.say)
    write_durably(path, as_html(page))
    shown: tuple[Run | Sweep, ...] = (one,) if isinstance(one, Run) else (one, *one.runs)
    say([*(remark for each in shown if status_of(each) for remark in remarks_of(each)), *missing])
    tell(f"report: {path}")
    return max(map(status_of, shown))
