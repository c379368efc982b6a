"""A system that is not Linux: what macOS or Windows lack is hidden, before anything else is imported."""

import builtins
import io
import os
import shutil
import signal
import socket
import sys
import threading  # noqa: F401  # some modules of the library look at import for what is taken away below
from collections.abc import Callable
from typing import Any

MODULES = ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty")
OS = (
    *("fork", "forkpty", "getuid", "geteuid", "getgid", "getpgid", "killpg", "setsid", "sched_getaffinity"),
    *(
        "pidfd_open",
        "posix_fadvise",
        "fchmod",
        "fchown",
        "mkfifo",
        "nice",
        "getloadavg",
        "posix_fallocate",
        "wait4",
        "waitid",
    ),
    *("O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW", "O_PATH", "memfd_create", "sync", "fdatasync"),
)
SIGNALS = ("SIGALRM", "SIGCHLD", "SIGHUP", "SIGKILL", "SIGUSR1", "SIGUSR2", "setitimer", "pthread_sigmask")


def hide() -> None:
    """Take away modules, calls and files, and what Windows refuses: to open a directory, to rename an open file."""
    for name in MODULES:
        sys.modules[name] = None  # type: ignore[assignment]  # so an import of it fails
    shutil._use_fd_functions = False  # type: ignore[attr-defined]  # as where `os.open` opens no directory
    open_files = _open_files(os.listdir, os.readlink, io.open)
    for call in ("open", "listdir", "stat", "readlink", "scandir"):
        setattr(os, call, _without_proc(getattr(os, call)))
    builtins.open = io.open = _without_proc(io.open)
    for call in ("rename", "replace", "unlink", "remove"):
        setattr(os, call, _refusing(open_files, getattr(os, call)))
    os.open = _no_directory(os.open)
    for module, names in ((os, OS), (signal, SIGNALS), (socket, ("AF_UNIX",))):
        for name in names:
            delattr(module, name)


def _without_proc(call: Callable[..., Any]) -> Callable[..., Any]:
    def checked(path: Any = ".", *arguments: Any, **named: Any) -> Any:
        if isinstance(path, str | bytes | os.PathLike) and os.fsdecode(path).startswith("/proc"):
            raise FileNotFoundError(2, "there is no /proc", os.fsdecode(path))
        return call(path, *arguments, **named)

    return checked


def _no_directory(call: Callable[..., Any]) -> Callable[..., Any]:
    def checked(path: Any, *arguments: Any, **named: Any) -> Any:
        if os.path.isdir(path):
            raise PermissionError(13, "a directory cannot be opened", path)
        return call(path, *arguments, **named)

    return checked


def _refusing(open_files: Callable[[], set[str]], call: Callable[..., Any]) -> Callable[..., Any]:
    def checked(path: Any, *arguments: Any, **named: Any) -> Any:
        place = os.path.realpath(path)
        if any(file == place or file.startswith(f"{place}/") for file in open_files()):
            raise PermissionError(13, "the file is open", path)
        return call(path, *arguments, **named)

    return checked


def _open_files(
    listdir: Callable[[str], list[str]], readlink: Callable[[str], str], open_map: Callable[[str], Any]
) -> Callable[[], set[str]]:
    def listed() -> set[str]:
        files = set()
        for handle in listdir("/proc/self/fd"):
            try:
                files.add(readlink(f"/proc/self/fd/{handle}"))
            except OSError:  # that of the list itself
                continue
        with open_map("/proc/self/maps") as maps:
            return files | {line.split(maxsplit=5)[5].rstrip("\n") for line in maps if "/" in line}

    return listed
