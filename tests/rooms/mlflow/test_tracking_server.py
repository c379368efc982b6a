"""A real MLflow server takes what a SQLite store takes."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from interruptions import comes
from mirrored import LINES, build_run, build_sweep, everything
from test_backfill import quietly

from tacevo.tracking.track import track

pytestmark = pytest.mark.slow


@pytest.fixture
def server(tmp_path: Path) -> Iterator[str]:
    """Return the address of a real `mlflow server` on this machine, with a SQLite database."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port: int = free.getsockname()[1]
    command = [sys.executable, "-m", "mlflow", "server", "--host", "127.0.0.1", "--port", str(port), "--workers", "1"]
    stores = ["--backend-store-uri", f"sqlite:///{tmp_path}/server.db", "--artifacts-destination", f"{tmp_path}/files"]
    quiet = {"MLFLOW_DISABLE_TELEMETRY": "true", "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}

    def answers() -> bool:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port)):
            return True
        return False

    with (tmp_path / "server.log").open("wb") as log:
        process = subprocess.Popen(
            [*command, *stores], env={**os.environ, **quiet}, stdout=log, stderr=log, text=True, start_new_session=True
        )
    try:
        assert comes(process, answers), (tmp_path / "server.log").read_text(encoding="utf-8")
        yield f"http://127.0.0.1:{port}"
    finally:
        os.killpg(process.pid, signal.SIGKILL)  # it has children
        process.wait()


def test_server_shows_what_a_database_shows(server: str, tmp_path: Path, uri: str) -> None:
    """A sweep and a run beside it, written twice, look the same over HTTP as in SQLite."""
    build_sweep(tmp_path / "runs" / "sweep", LINES)
    build_run(tmp_path / "runs" / "alone", LINES)
    for address in (uri, server, server):
        track(tmp_path / "runs", address, quietly)
    assert everything(server) == everything(uri)
