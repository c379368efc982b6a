"""A real MLflow server that loses answers, is killed in the middle and started again, ends up with each run once."""

import contextlib
import http.client
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest
from mirrored import BASELINE, ENTRIES, build_run, build_sweep, everything
from test_mirroring import quietly, wait_for_runs

from tacevo.tracking.backfill import track

# MLflow uses a loader option of SQLAlchemy that its newest version deprecates.
pytestmark = pytest.mark.filterwarnings("ignore:The ``noload`` loader strategy is deprecated")

#: Seconds after which a server is taken for stuck; machines are busy.
PATIENCE = 300


class Server:
    """A real `mlflow server` on this machine, with a SQLite database, that keeps artifacts itself."""

    def __init__(self, folder: Path) -> None:
        self.database = folder / "server.db"
        self.log = folder / "server.log"
        self._artifacts = folder / "artifacts"
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port: int = free.getsockname()[1]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it; it is ready some seconds later."""
        quiet = {"MLFLOW_DISABLE_TELEMETRY": "true", "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
        command = [sys.executable, "-m", "mlflow", "server", "--host", "127.0.0.1", "--port", str(self.port)]
        stores = ["--backend-store-uri", f"sqlite:///{self.database}", "--artifacts-destination", str(self._artifacts)]
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                [*command, *stores, "--workers", "1"],
                env={**os.environ, **quiet},
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # it has children, which must go with it
            )

    def kill(self) -> None:
        """Kill it with all its processes, in the middle of whatever it does."""
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._process = None

    def wait(self) -> None:
        """Wait until it answers."""
        deadline = time.monotonic() + PATIENCE
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port)):
                return
            assert time.monotonic() < deadline, self.log.read_text(encoding="utf-8")
            time.sleep(0.2)


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    """Give a server that is ready."""
    server = Server(tmp_path)
    server.start()
    try:
        server.wait()
        yield server
    finally:
        server.kill()


@contextlib.contextmanager
def forgetful(server: Server) -> Iterator[str]:
    """Stand before a server, and lose every seventh answer, and every third about a new run; give the address."""
    asked = made = 0

    class Relay(BaseHTTPRequestHandler):
        def _relay(self) -> None:
            nonlocal asked, made
            self.close_connection = True
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            headers = {key: value for key, value in self.headers.items() if key not in {"Host", "Connection"}}
            connection = http.client.HTTPConnection("127.0.0.1", server.port)
            try:
                connection.request(self.command, self.path, body, headers)
                answer = connection.getresponse()
                content = answer.read()
            except (OSError, http.client.HTTPException):
                return  # the server is away, and so is the answer
            finally:
                connection.close()
            asked += 1
            if self.path.endswith("/runs/create"):
                made += 1
                if made % 3 == 0:
                    return
            elif asked % 7 == 0:
                return
            self.send_response(answer.status)
            self.send_header("Content-Type", answer.getheader("Content-Type", "application/json"))
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        do_GET = do_POST = do_PUT = do_PATCH = do_DELETE = _relay  # noqa: N815

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Relay) as relay:
        Thread(target=relay.serve_forever).start()
        try:
            yield f"http://127.0.0.1:{relay.server_port}"
        finally:
            relay.shutdown()
    assert made > 3, "no answer was lost"


def test_server_that_loses_answers_and_is_killed_has_each_run_once(
    server: Server, tmp_path: Path, uri: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One command, in the middle of which the server dies and comes back, writes what an undisturbed one writes.

    An answer that is lost after the run was made has the client ask again, which makes it twice.
    """
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "8")  # as slow as it may start here
    more = [replace(BASELINE, slot=slot, id=f"g00s{slot:02}") for slot in range(3, 9)]
    build_sweep(tmp_path / "runs" / "sweep", [*ENTRIES[:4], *more, *ENTRIES[4:]])
    build_run(tmp_path / "runs" / "alone", ENTRIES)

    def restart() -> None:
        wait_for_runs(server.database, 8)
        server.kill()
        server.start()

    killer = Thread(target=restart)
    killer.start()
    with forgetful(server) as address:
        tracked = track(tmp_path / "runs", address, quietly)
        killer.join()
        assert tracked.failed == ()
        assert len(tracked.done) == 3
        assert track(tmp_path / "runs", address, quietly).failed == ()
        track(tmp_path / "runs", uri, quietly)
        assert everything(address) == everything(uri)
