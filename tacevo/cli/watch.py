"""The command `tacevo watch`: the report page of a search that may still run, served to this machine alone.

What it promises: it listens on 127.0.0.1; who asks needs the token in the address, and a Host that is this machine's,
so that no page from elsewhere reaches it by a name of its own; it answers GET, and writes nothing.
"""

import argparse
import contextlib
import hashlib
import secrets
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from analysis.report.collection import Collection, collect, tables_of
from analysis.report.page.contents import PageContents, SweepContents
from analysis.report.page.html import as_data, html_around
from analysis.report.page.of_run import RunMaterial, read_texts
from analysis.report.page.of_sweep import sweep_contents
from analysis.report.page.whole import page_contents, replay_commands
from analysis.report.sweep_collection import collect_sweep
from analysis.runs.begun import load_begun
from tacevo.cli.common import DONE, Parser, existing_store
from tacevo.errors import ConfigError, TacevoError
from tacevo.search.files import finished_digest
from tacevo.storage.notes import NOTE, read_note
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.text import counted

#: The files of a run that its page follows from.
_FOLLOWED = (NOTE, "run.json", "ledger.jsonl", "studies/*/study.json")

#: What may stand in the directory of a run before its run.json.
_BEFORE = {NOTE, "ledger.jsonl"}

_LAST_PORT = 65_535


def add_watch(parser: Parser) -> None:
    """Describe `tacevo watch`."""
    parser.description = (
        "Serve the page of `tacevo report` to this machine alone, of a run or a sweep that may still be at work; it "
        "follows the search, also when that is stopped and continued. Ctrl-C ends it."
    )
    parser.add_argument("run", metavar="RUN", help="the directory of a run or a sweep, begun or not")
    parser.add_argument("--open", action="store_true", help="open it in the browser")
    parser.add_argument(
        "--port", metavar="N", type=int, default=0, help="port to listen on (default: any that is free)"
    )
    parser.add_argument("--store", metavar="DIR", help="directory of the stores, if it was moved")
    parser.set_defaults(command=_watch, interrupted="the search was not touched")


def _watch(options: argparse.Namespace) -> int:
    store, path = existing_store(options.store), Path(options.run)
    if path.is_file():
        remedy = "`tacevo report` makes the page of a bundle, which does not change"
        raise ConfigError(f"the file {path}", expected="the directory of a run or a sweep", remedy=remedy)
    _check_may_begin(path)
    if not 0 <= options.port <= _LAST_PORT:
        remedy = "leave it out for any that is free"
        raise ConfigError(str(options.port), place="--port", expected=f"0 to {_LAST_PORT}", remedy=remedy)
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(Server(LivePage(path, None if store is None else Path(store)), options.port))
        print(f"watch: {server.address}", flush=True)
        if not path.exists():
            print(f"{path} does not exist yet; the page waits for it", flush=True)
        if options.open:
            stack.enter_context(opened_privately(server.address, webbrowser.open))
        server.serve_forever()
    return DONE


def _check_may_begin(path: Path) -> None:
    """Refuse a directory of something else, for whose search the page would wait for ever."""
    if not path.is_dir() or any((path / name).exists() for name in ("run.json", "sweep.json")):
        return
    if any(not file.name.startswith(".") and file.name not in _BEFORE for file in path.iterdir()):
        raise ConfigError(
            "a directory without run.json and sweep.json",
            place=str(path),
            expected="the directory of a run or a sweep, or one that is empty or absent and waits for it",
        )


@contextlib.contextmanager
def opened_privately(address: str, browse: Callable[[str], object]) -> Iterator[None]:
    """Open an address by a file that only this user can read: every user sees the command line of a browser.

    Args:
        address: what the file leads to; it holds the token.
        browse: opens the address of the file.
    """
    with tempfile.TemporaryDirectory(prefix="tacevo-watch-") as directory:
        file = Path(directory) / "watch.html"
        file.write_text(f'<!doctype html><meta http-equiv="refresh" content="0; url={address}">', encoding="utf-8")
        # A browser of the terminal returns when it is closed, and it must be served until then.
        threading.Thread(target=browse, args=[file.as_uri()], daemon=True).start()
        yield


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """What the page shows at one moment."""

    contents: PageContents
    #: The contents as `as_data` writes them, and the SHA-256 of that.
    data: str
    version: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _Seen:
    """All that tells whether a run has changed."""

    #: Whether a search is at work in it.
    is_busy: bool
    #: Path, time and size of each of its files.
    files: tuple[object, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reading:
    """What a run gave when it was last read."""

    seen: _Seen
    is_finished: bool
    #: What its page is made from; None before its first generation has ended.
    material: RunMaterial | None


class LivePage:
    """The page of a directory as it is now; made again when a file of it has changed.

    Args:
        path: of a run or a sweep; it need not exist yet.
        store: where the stores lie, if not where the runs have them.
    """

    def __init__(self, path: Path, store: Path | None = None) -> None:
        self._path = path
        self._store = store
        self._lock = threading.Lock()
        #: What the present page was made of; None where it could not be made.
        self._seen: object = None
        self._readings: dict[Path, _Reading] = {}
        self._keep(page_contents([], title=path.resolve().name, live=True, state="", checked=[], commands=[]))

    def now(self) -> Snapshot:
        """Return the page of the files; where they cannot be read, the last one and why."""
        with self._lock:
            try:
                runs = {run.path: _look_at(run) for run in self._runs()}
                seen = _state_of(self._path / "sweep.json"), runs
                if seen != self._seen:
                    self._keep(self._made([self._read(RunDirectory(path), seen) for path, seen in runs.items()]))
                    self._seen = seen
            except (TacevoError, OSError) as error:  # e.g. a file that was removed, because the search begins again
                self._seen = None
                self._keep(replace(self._snapshot.contents, state=f"This cannot be read now: {error}"))
            return self._snapshot

    def _keep(self, contents: PageContents) -> None:
        data = as_data(contents)
        self._snapshot = Snapshot(contents=contents, data=data, version=hashlib.sha256(data.encode()).hexdigest())

    def _runs(self) -> list[RunDirectory]:
        """List the runs, begun or not."""
        directory = SweepDirectory(self._path)
        return [directory.run(job) for job in directory.read().jobs] if directory.is_one else [RunDirectory(self._path)]

    def _made(self, readings: list[_Reading]) -> PageContents:
        sweep, reason = self._compared() if SweepDirectory(self._path).is_one else (None, "")
        name = self._path.resolve().name
        return page_contents(
            [one.material for one in readings if one.material is not None],
            sweep=sweep,
            title=name,
            live=True,
            state=f"{_standing(readings)}{reason}",
            checked=[
                "Each ledger's chain, as far as it goes. A run that is not finished has no digest of its own yet.",
                "`tacevo report` of a finished run also draws sample images and compares motifs; this page does not.",
            ],
            commands=replay_commands(name) if all(one.is_finished for one in readings) else [],
        )

    def _read(self, run: RunDirectory, seen: _Seen) -> _Reading:
        """Read a run, if it has changed since the last time."""
        known = self._readings.get(run.path)
        if known is None or known.seen != seen:
            is_finished = (run.path / "run.json").exists() and finished_digest(run) is not None
            found, material = self._collected(run, is_finished=is_finished), None
            if found is not None:
                remarks = [*read_note(run.path), *found.run.not_sent.values(), *found.left_out, *found.remarks]
                recorded, tables = read_texts(found.run), tables_of(found, None)
                material = RunMaterial(found=found, recorded=recorded, tables=tables, remarks=remarks)
            known = self._readings[run.path] = _Reading(seen=seen, is_finished=is_finished, material=material)
        return known

    def _collected(self, run: RunDirectory, *, is_finished: bool) -> Collection | None:
        """Read a run, with its studies once it is finished; None before its first generation has ended."""
        if is_finished:
            return collect(run.path, self._store)
        begun = load_begun(run.path, self._store) if (run.path / "run.json").exists() else None
        if begun is None:
            return None
        return Collection(run=begun[0], niches=begun[1], studies=(), reestimates=(), left_out=())

    def _compared(self) -> tuple[SweepContents | None, str]:
        """Compare the arms of the finished jobs; or return why not."""
        try:
            return sweep_contents(collect_sweep(self._path, self._store)), ""
        except (TacevoError, OSError) as error:
            return None, f" The arms are not compared yet: {error}"


def _look_at(run: RunDirectory) -> _Seen:
    """Look whether a search is at work in a run, and what its files are."""
    files = [file for pattern in _FOLLOWED for file in sorted(run.path.glob(pattern))]
    return _Seen(is_busy=run.is_busy, files=tuple(map(_state_of, files)))


def _state_of(file: Path) -> object:
    with contextlib.suppress(OSError):
        state = file.stat()
        return str(file), state.st_mtime_ns, state.st_size
    return None


def _standing(readings: list[_Reading]) -> str:
    """Say how many searches are finished, and how many run."""
    finished = sum(one.is_finished for one in readings)
    running = sum(one.seen.is_busy for one in readings)
    return f"{finished} of {counted(len(readings), 'run')} finished, {running} at work."


class Server(ThreadingHTTPServer):
    """Serves a page to this machine under an address that nobody can guess.

    Args:
        page: what is served.
        port: 0 for any that is free.
    """

    daemon_threads = True

    def __init__(self, page: LivePage, port: int) -> None:
        super().__init__(("127.0.0.1", port), _Handler)
        self.page = page
        self.root = f"/{secrets.token_urlsafe(24)}/"

    @property
    def address(self) -> str:
        """The page's address."""
        return f"http://127.0.0.1:{self.server_port}{self.root}"


class _Handler(BaseHTTPRequestHandler):
    """Answers GET of the page and of its contents as JSON, and nothing else."""

    server: Server
    server_version, sys_version = "tacevo", ""
    timeout = 10

    def parse_request(self) -> bool:
        """Read a request; refuse every method but GET."""
        if not super().parse_request():
            return False
        if self.command != "GET":
            self.send_error(HTTPStatus.METHOD_NOT_ALLOWED)
            return False
        return True

    def do_GET(self) -> None:
        """Answer; who has not the token, or calls this machine by another name, learns nothing."""
        hosts = {f"{name}:{self.server.server_port}" for name in ("127.0.0.1", "localhost")}
        known = {f"{self.server.root}{name}": name for name in ("", "data")}
        name = next((known[path] for path in known if secrets.compare_digest(path.encode(), self.path.encode())), None)
        if name is None or self.headers.get("Host") not in hosts:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        shown = self.server.page.now()
        with contextlib.suppress(ConnectionError):  # the browser was closed meanwhile
            if name == "":
                self._answer(shown, "text/html", html_around(shown.data, title=shown.contents.title, live=True))
            elif self.headers.get("If-None-Match") == f'"{shown.version}"':
                self.send_response(HTTPStatus.NOT_MODIFIED)
                self.end_headers()
            else:
                self._answer(shown, "application/json", shown.data)

    def log_message(self, format: str, *args: object) -> None:
        """Keep the terminal quiet."""

    def _answer(self, shown: Snapshot, kind: str, text: str) -> None:
        body = text.encode()
        self.send_response(HTTPStatus.OK)
        headers = {
            "Content-Type": f"{kind}; charset=utf-8",
            "Content-Length": str(len(body)),
            "ETag": f'"{shown.version}"',
            "Cache-Control": "no-store",
            "Content-Security-Policy": "frame-ancestors 'none'",
            "Cross-Origin-Resource-Policy": "same-origin",
            "X-Content-Type-Options": "nosniff",
        }
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)
