"""Traps that a hostile candidate springs if it gets out: a directory, ports, sockets, a secret in the environment.

The places are those that the shared hostile programs aim at when they find no environment.
"""

import contextlib
import os
import select
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

from waiting import eventually

FOLDER = Path("/tmp/tacevo_canary")
PORT, THEIR_PORT = 47654, 47655
SECRET = "a secret of the search 5c1e"

_ABSTRACT = "\0tacevo_h024"
_SOCKET = FOLDER / "h024.sock"
_PAUSE = 0.05  # seconds between two looks at their port


class Canaries:
    """The traps, set; `sprung` tells which were touched since the last time it was asked."""

    def __init__(self, listeners: list[socket.socket]) -> None:
        self._listeners = listeners
        self._ended = threading.Event()
        self._served = threading.Event()
        self._watch = threading.Thread(target=self._watch_their_port, name="their port")
        self._watch.start()

    def sprung(self) -> list[str]:
        """Name every trap that was touched, and take what came out of it."""
        sprung = [f"file {path.name}" for path in FOLDER.iterdir() if path != _SOCKET]
        for listener in select.select(self._listeners, [], [], 0)[0]:
            sprung.append(f"message to {listener.getsockname()!r}")
            if listener.type == socket.SOCK_STREAM:
                listener.accept()[0].close()
            else:
                listener.recv(1_000)
        if self._served.is_set():
            self._served.clear()
            sprung.append(f"port {THEIR_PORT} is served")
        if os.environ.get("TACEVO_CANARY") != SECRET:
            sprung.append("the environment of the search")
        return sprung

    def close(self) -> None:
        """End the watch."""
        self._ended.set()
        self._watch.join()

    def _watch_their_port(self) -> None:
        while not self._ended.wait(_PAUSE):
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", THEIR_PORT), timeout=1) as client:
                if client.getsockname() != client.getpeername():  # a connection may by chance be made with itself
                    self._served.set()


@contextlib.contextmanager
def canaries() -> Iterator[Canaries]:
    """Set the traps for a while; the caller has put `SECRET` into the environment.

    Raises:
        OSError: a port is in use for long, or the directory belongs to somebody else.
    """
    FOLDER.mkdir(exist_ok=True)
    FOLDER.chmod(0o777)
    for path in FOLDER.iterdir():
        path.unlink()
    with contextlib.ExitStack() as stack:
        listeners = [
            _listening(stack, socket.AF_INET, socket.SOCK_STREAM, ("127.0.0.1", PORT)),
            _listening(stack, socket.AF_INET, socket.SOCK_DGRAM, ("127.0.0.1", PORT)),
            _listening(stack, socket.AF_UNIX, socket.SOCK_STREAM, _ABSTRACT),
            _listening(stack, socket.AF_UNIX, socket.SOCK_STREAM, str(_SOCKET)),
        ]
        opened = Canaries(listeners)
        stack.callback(opened.close)
        yield opened
    _SOCKET.unlink()
    FOLDER.rmdir()


def _listening(
    stack: contextlib.ExitStack, family: socket.AddressFamily, kind: socket.SocketKind, place: tuple[str, int] | str
) -> socket.socket:
    listener = stack.enter_context(socket.socket(family, kind))
    if family == socket.AF_INET:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    if not eventually(lambda: _binds(listener, place)):  # somebody's connection may have got the port by chance
        raise OSError(f"the tests need {place!r}, which another process has; end it")
    if kind == socket.SOCK_STREAM:
        listener.listen()
    return listener


def _binds(listener: socket.socket, place: tuple[str, int] | str) -> bool:
    try:
        listener.bind(place)
    except OSError:
        return False
    return True
