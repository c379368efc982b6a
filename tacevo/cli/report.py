"""The command `tacevo report`: a page to look into a run or a sweep."""

from functools import partial
from pathlib import Path

from tacevo.api.runs import Run
from tacevo.api.sweeps import Sweep
from tacevo.cli.common import existing_store, tell
from tacevo.cli.tables import open_all, remarks_of, say, status_of
from tacevo.runs.progress import Progress
from tacevo.storage.files import write_durably


def run_report(run: str, path: Path, *, follows: bool, store: str | None) -> int:
    """Write the page of a run or a sweep into a file, again and again while it is at work where it `follows`."""
    from analysis.report.page.html import as_html
    from tacevo.api.page import page_of

    source, store = Path(run), existing_store(store)
    name = source.resolve().name
    if source.parent.is_file():
        name = f"{source.parent.name}/{name}"
    if follows and source.is_dir():
        from analysis.report.following import follow

        tell(f"report: {path}", flush=True)
        follow(source, path, None if store is None else Path(store), partial(tell, flush=True))
    (one,) = open_all([run], store)
    with Progress() as view:
        page, missing = page_of(one, name, view.say)
    write_durably(path, as_html(page))
    shown: tuple[Run | Sweep, ...] = (one,) if isinstance(one, Run) else (one, *one.runs)
    say([*(remark for each in shown if status_of(each) for remark in remarks_of(each)), *missing])
    tell(f"report: {path}")
    return max(map(status_of, shown))
