"""Promise: behind Landlock alone, without the filter, no file, network or process outside is within reach."""

import multiprocessing
import os
import socket
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pytest

from tacevo.sandbox import landlock
from tacevo.sandbox.kernel import renounce_privileges

needs_landlock = pytest.mark.skipif(not landlock.version(), reason="the kernel has no Landlock")


def _attempts(folder: Path, tcp: int, abstract: str, search: int) -> dict[str, bool]:
    """Try what Landlock governs; tell for each whether it worked."""
    acts: dict[str, Callable[[], object]] = {
        "read": partial(os.open, folder / "file", os.O_RDONLY),
        "write": partial(os.open, folder / "file", os.O_WRONLY),
        "make": partial(os.open, folder / "new", os.O_WRONLY | os.O_CREAT),
        "list": partial(os.listdir, folder),
        "folder": partial(os.mkdir, folder / "made"),
        "link": partial(os.symlink, "text", folder / "mark"),
        "empty": partial(os.truncate, folder / "file", 0),
        "remove": partial(os.unlink, folder / "doomed"),
        "connect": partial(_connect, socket.AF_INET, ("127.0.0.1", tcp)),
        "bind": partial(_bind, ("127.0.0.1", 0)),
        "abstract": partial(_connect, socket.AF_UNIX, abstract),
        "signal": partial(os.kill, search, 0),
    }
    return {name: _works(act) for name, act in acts.items()}


def _works(act: Callable[[], object]) -> bool:
    try:
        act()
    except OSError:
        return False
    return True


def _connect(family: socket.AddressFamily, address: object) -> None:
    with socket.socket(family) as client:
        client.connect(address)  # type: ignore[arg-type]


def _bind(address: tuple[str, int]) -> None:
    with socket.socket() as server:
        server.bind(address)


def _behind_the_wall(answers: Connection, wall: bool, *places: Any) -> None:
    if wall:
        renounce_privileges()
        landlock.restrict()
    answers.send(_attempts(*places))


def tried(folder: Path, *, wall: bool) -> dict[str, bool]:
    """Make every attempt in a process of its own."""
    (folder / "file").write_text("x")
    (folder / "doomed").touch()
    abstract = f"\0tacevo-test-{os.getpid()}"
    with socket.create_server(("127.0.0.1", 0)) as tcp, socket.socket(socket.AF_UNIX) as unix:
        unix.bind(abstract)
        unix.listen()
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        places = (folder, tcp.getsockname()[1], abstract, os.getpid())
        process = context.Process(target=_behind_the_wall, args=(theirs, wall, *places))
        process.start()
        worked: dict[str, bool] = ours.recv()
        process.join()
    return worked


@needs_landlock
def test_nothing_outside_is_within_reach(tmp_path: Path) -> None:
    """Each attempt works without the wall, and none behind it, as far as the kernel's version goes."""
    assert all(tried(tmp_path, wall=False).values())
    (tmp_path / "made").rmdir()
    (tmp_path / "new").unlink()
    (tmp_path / "mark").unlink()
    later = {"connect", "bind"} if landlock.version() < landlock.NETWORK_SINCE else set()
    later |= {"empty"} if landlock.version() < 3 else set()
    later |= {"abstract", "signal"} if landlock.version() < landlock.SCOPES_SINCE else set()
    assert {name for name, worked in tried(tmp_path, wall=True).items() if worked} <= later
    assert (tmp_path / "file").read_text() == "x"


@pytest.mark.parametrize(
    ("known", "files", "network", "scopes"),
    [(1, 13, 0, 0), (2, 14, 0, 0), (3, 15, 0, 0), (4, 15, 2, 0), (5, 16, 2, 0), (6, 16, 2, 2), (99, 16, 2, 2)],
)
def test_all_that_a_version_knows_is_refused(known: int, files: int, network: int, scopes: int) -> None:
    """Asking an old kernel for a new right would fail, and asking for less would leave a gap."""
    assert landlock.refused(known) == (2**files - 1, 2**network - 1, 2**scopes - 1)
