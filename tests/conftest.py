"""What holds for every test: no connection leaves this machine, and Hypothesis tries the same examples every time."""

import ipaddress
import os
import shutil
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import interruptions
import pytest
from hypothesis import settings
from smallest import SMALLEST, UNTRACKED

settings.register_profile("tacevo", deadline=None, derandomize=True)
settings.load_profile("tacevo")


@pytest.fixture(scope="session")
def whole_search(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Give the folder and the digest of an undisturbed search (`interruptions`); nothing may be changed in it."""
    folder = tmp_path_factory.mktemp("whole")
    return folder, interruptions.finish(interruptions.start(folder, "tracking=none"))


@pytest.fixture(scope="session", autouse=True)
def _loopback_only() -> Iterator[None]:
    """Refuse every connection but to this machine itself."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("connect", "connect_ex"):
            patch.setattr(socket.socket, name, _guarded(getattr(socket.socket, name)))
        yield


def _guarded(connect: Callable[[socket.socket, Any], Any]) -> Callable[[socket.socket, Any], Any]:
    """Put a check of the address before a method that connects."""

    def guarded(sock: socket.socket, address: Any) -> Any:
        if sock.family in {socket.AF_INET, socket.AF_INET6} and not _is_loopback(address[0]):
            raise RuntimeError(f"tests reach no network, but one connects to {address}; pass a fake in instead")
        return connect(sock, address)

    return guarded


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:  # a name, not an address
        return host == "localhost"


@pytest.fixture(scope="session")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the folder of a tiny run with a study (`run`, `cache`), published as `run.zip`; nothing may be changed."""
    from tacevo.cli.app import main

    folder = tmp_path_factory.mktemp("published")
    sizes = ["search.generations=1", "search.candidates=3", "search.initial=2"]
    where = [f"run.dir={folder / 'run'}", f"store.root={folder / 'cache'}"]
    assert main(["search", *SMALLEST, UNTRACKED, *sizes, *where]) == 0
    assert main(["study", f"run={folder / 'run'}", "elites=1", "seeds=4", "epochs=1"]) == 0
    assert main(["publish", str(folder / "run"), "-o", str(folder / "run.zip"), "--author", "A. Nyone"]) == 0
    return folder


@pytest.fixture(scope="session")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the folder of a tiny sweep (`sweep`, `cache`), published as `sweep.zip`; nothing may be changed."""
    from tiny_sweep import run_sweep

    from tacevo.cli.app import main

    folder = tmp_path_factory.mktemp("swept")
    run_sweep(folder / "sweep", folder / "cache")
    assert main(["publish", str(folder / "sweep"), "-o", str(folder / "sweep.zip"), "--author", "A. Nyone"]) == 0
    return folder


@pytest.fixture(scope="session")
def empty_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make an empty MLflow database once, because its many migrations take seconds."""
    os.environ["MLFLOW_DISABLE_TELEMETRY"] = "true"
    from mlflow import MlflowClient

    path = tmp_path_factory.mktemp("mlflow") / "mlflow.db"
    MlflowClient(f"sqlite:///{path}")
    return path


@pytest.fixture
def uri(empty_store: Path, tmp_path: Path) -> str:
    """Give the URI of a store of the test's own."""
    shutil.copy(empty_store, tmp_path / "mlflow.db")
    return f"sqlite:///{tmp_path}/mlflow.db"
