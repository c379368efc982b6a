"""What holds for every test: no connection leaves this machine, and Hypothesis tries the same examples every time.

What is expensive to make and needed by several tests is made once a session, for all workers of pytest-xdist.
"""

import gc
import ipaddress
import json
import os
import shutil
import signal
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import commands
import interruptions
import pytest
from checkout import SHARED, VARIABLE
from filelock import FileLock
from hypothesis import settings
from smallest import PUBLISHED_SIZES, SMALLEST, UNTRACKED, Once
from syrupy.extensions.single_file import SingleFileSnapshotExtension, WriteMode

if TYPE_CHECKING:
    from playwright.sync_api import Browser
    from slurm_cluster import Slurm
    from syrupy.assertion import SnapshotAssertion

pytest_plugins = ["hiding"]

# A shell has what it starts in the background ignore Ctrl-C, and so would every process that a test starts.
signal.signal(signal.SIGINT, signal.default_int_handler)

# pyribs keeps what it compiles in the home directory or beside itself, and cannot be imported where it may not.
if not os.access(Path.home(), os.W_OK):
    os.environ.setdefault("NUMBA_CACHE_DIR", f"{tempfile.gettempdir()}/numba-{os.getuid()}")

settings.register_profile("tacevo", deadline=None, derandomize=True, max_examples=40)
settings.register_profile("thorough", settings.get_profile("tacevo"), max_examples=400)  # `make test-all`
settings.load_profile("tacevo")


def pytest_report_header() -> str:
    """Say whether tests try real recordings and answers, too, which are not published."""
    where = SHARED if SHARED.is_dir() else f"none ({VARIABLE} names their directory)"
    return f"recordings and real answers: {where}"


def pytest_collectstart() -> None:
    """Keep what was imported out of the garbage collections of what is imported next, which statsmodels forces."""
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep N parameters of a test that is marked `few(N)` in a quick run, spread evenly; the others are slow."""
    marked: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("few"):
            marked.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for cases in marked.values():
        (kept,) = cases[0].get_closest_marker("few").args  # type: ignore[union-attr]  # it was looked for above
        quick = {len(cases) * number // kept for number in range(kept)}
        for number, case in enumerate(cases):
            if number not in quick:
                case.add_marker("slow")


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> None:
    """Let torch, where it is imported, use one thread: for tensors this small a second one waits more than it helps."""
    if torch := sys.modules.get("torch"):
        torch.set_num_threads(1)


@pytest.fixture(scope="module", autouse=True)
def _few_objects_to_collect() -> None:
    """Keep what earlier modules made out of garbage collections, each of which would look at all of it again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Once:
    """Return a function that fills a directory of a name in the first worker that asks, while the others wait."""
    own = tmp_path_factory.getbasetemp()
    session = own if worker_id == "master" else own.parent

    def once(name: str, fill: Callable[[Path], object]) -> Path:
        folder, filled = session / "shared" / name, session / f"{name}.filled"
        with FileLock(session / f"{name}.lock"):
            if not filled.exists():
                folder.mkdir(parents=True)
                fill(folder)
                filled.touch()
        return folder

    return once


@pytest.fixture(scope="session")
def whole_search(once: Once) -> tuple[Path, str]:
    """Return the directory and the digest of an undisturbed search (`interruptions`); no test may change it."""
    folder = once("whole", lambda folder: interruptions.finish(interruptions.start(folder, UNTRACKED)))
    return folder, json.loads((folder / "run" / "run.json").read_text())["digest"]


class _Text(SingleFileSnapshotExtension):
    """Keeps each text in a file of its own, so that a difference is read as one of texts."""

    _write_mode = WriteMode.TEXT
    file_extension = "txt"


@pytest.fixture
def recorded_text(snapshot: "SnapshotAssertion") -> "SnapshotAssertion":
    """Return what equals the text in the test's file below `__snapshots__`; `make snapshots` writes these anew."""
    return snapshot.use_extension(_Text)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in an empty directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def copied(whole_search: tuple[Path, str], place: Path) -> Path:
    """Work in a copy of the directory of `whole_search`, to be spoilt."""
    shutil.copytree(whole_search[0], place, dirs_exist_ok=True)
    return place


@pytest.fixture
def keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put keys where the SDKs look for them."""
    from asked import KEY

    for name in ("ANTHROPIC_API_KEY", "OPENAI_API_KEY"):
        monkeypatch.setenv(name, KEY)


@pytest.fixture
def torch_settings() -> Iterator[None]:
    """Undo what the probe sets for its whole process, where that is the test's own and does not end with it."""
    import torch

    deterministic = torch.are_deterministic_algorithms_enabled()
    with torch.random.fork_rng(devices=[]):
        yield
    torch.use_deterministic_algorithms(deterministic)


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
def published(once: Once) -> Path:
    """Return a directory with a run (`run`, `cache`), its study, and both as `run.zip`; no test may change it."""
    return once("published", _publish_run)


def _publish_run(folder: Path) -> None:
    from tacevo.cli.app import main

    where = [f"run.dir={folder / 'run'}", f"store.root={folder / 'cache'}"]
    assert main(["search", *SMALLEST, UNTRACKED, *PUBLISHED_SIZES, *where]) == 0
    assert main(["study", f"run={folder / 'run'}", "elites=1", "seeds=4", "epochs=1"]) == 0
    commands.publish(str(folder / "run"), "-o", str(folder / "run.zip"), "--author", "A. Nyone")


@pytest.fixture
def folder(published: Path, place: Path) -> Path:
    """Work in a directory with a copy of that run, its study and its stores (`run`, `cache`), to be damaged."""
    for name in ("run", "cache"):
        shutil.copytree(published / name, place / name)
    described = json.loads((place / "run" / "run.json").read_text())
    described["config"]["run"]["dir"], described["config"]["store"]["root"] = "run", "cache"
    (place / "run" / "run.json").write_text(json.dumps(described))
    return place


@pytest.fixture
def run(published: Path, place: Path) -> Path:
    """Work beside a copy of that run with its study (`run`), to be spoilt; its stores are the session's."""
    shutil.copytree(published / "run", place / "run")
    return Path("run")


@pytest.fixture
def bundle(published: Path) -> Path:
    """Return that run with its study as one published file; no test may change it."""
    return published / "run.zip"


@pytest.fixture
def sweep(swept: Path, place: Path) -> Path:
    """Work beside a copy of `swept`'s sweep (`sweep`), to be spoilt; its stores are the session's."""
    return Path(shutil.copytree(swept / "sweep", place / "sweep"))


@pytest.fixture(scope="session")
def swept(once: Once) -> Path:
    """Return a directory with a tiny sweep (`sweep`, `cache`), published as `sweep.zip`; no test may change it."""
    return once("swept", _publish_sweep)


def _publish_sweep(folder: Path) -> None:
    from tiny_sweep import run_sweep

    run_sweep(folder / "sweep", folder / "cache")
    commands.publish(str(folder / "sweep"), "-o", str(folder / "sweep.zip"), "--author", "A. Nyone")


@pytest.fixture(scope="session")
def empty_store(once: Once) -> Path:
    """Make an empty MLflow database once, because its many migrations take seconds."""
    os.environ["MLFLOW_DISABLE_TELEMETRY"] = "true"
    return once("mlflow", _migrate) / "mlflow.db"


def _migrate(folder: Path) -> None:
    from mlflow import MlflowClient

    MlflowClient(f"sqlite:///{folder}/mlflow.db")


@pytest.fixture
def uri(empty_store: Path, tmp_path: Path) -> str:
    """Return the URI of a store of the test's own."""
    shutil.copy(empty_store, tmp_path / "mlflow.db")
    return f"sqlite:///{tmp_path}/mlflow.db"


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    """Start Chromium, once a module; without it tests are skipped, unless TACEVO_BROWSER=1 insists, as in the gate."""
    from playwright.sync_api import sync_playwright  # for these tests alone

    path = shutil.which("chromium")
    if path is None:
        if os.environ.get("TACEVO_BROWSER") == "1":
            pytest.fail("TACEVO_BROWSER=1, but there is no chromium: `apt-get install chromium`")
        pytest.skip("no chromium: `apt-get install chromium`")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path)
        yield started
        started.close()


@pytest.fixture(scope="module")
def slurm() -> "Iterator[Slurm]":
    """Start a Slurm, once a module; without it tests are skipped, unless TACEVO_SLURM=1 insists, as in the gate."""
    from slurm_cluster import missing_programs, slurm_cluster

    missing = ", ".join(missing_programs())
    if missing:
        if os.environ.get("TACEVO_SLURM") == "1":
            pytest.fail(f"TACEVO_SLURM=1, but there is no {missing}: `apt-get install slurm-wlm munge`")
        pytest.skip(f"no {missing}: `apt-get install slurm-wlm munge`")
    with slurm_cluster() as cluster:
        yield cluster


@pytest.fixture(scope="session")
def alone(once: Once) -> Path:
    """Return a directory with the sweep of `cluster_sweeps`, which ran on this machine; no test may change it."""
    from cluster_sweeps import sweep_here

    return once("swept alone", sweep_here)


@pytest.fixture(scope="session")
def studied_alone(once: Once, alone: Path) -> Path:
    """Return a copy of it with a study of a job; no test may change it."""
    from cluster_sweeps import study_here

    return once("studied alone", lambda folder: study_here(alone, folder))
