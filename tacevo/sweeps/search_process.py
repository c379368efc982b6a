"""The search of a job, as a process.

It is the search that a user would begin by `tacevo search ... run.dir=SWEEP/NAME`, which its log begins with, in a
process and a session of its own. So a job that fails or is killed stops no other, and a terminal's Ctrl-C reaches the
launching process only. Here and on Slurm it is started by an order, which holds its configuration: what was composed
before the sweep began is what runs.
"""

import contextlib
import json
import os
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import IO

from tacevo.config.schema import RunConfig
from tacevo.parts.sources import recalled
from tacevo.records import Json, to_json
from tacevo.sandbox.kernel import end_with
from tacevo.storage.files import write_durably
from tacevo.storage.sweep_directory import Job, SweepDirectory, seeded
from tacevo.text import as_override

#: Seconds that a search has to stop.
GRACE = 60.0

#: The exit status of a search that was told to stop, by Ctrl-C or by SIGTERM.
_INTERRUPTED = (130, 143)

#: Bytes that the line of an exit status has at most.
_STATUS = 8

#: The beginning of a log's first line, which holds the command.
_TYPED = "$ "

#: The beginning of a failed command's last line.
_ERROR = "error: "


def overrides_of(directory: SweepDirectory, job: Job) -> tuple[str, ...]:
    """Return the settings of a job: what all share, its own, and what follows from its seed."""
    sweep = directory.read()
    return (*sweep.overrides, *job.overrides, *seeded(sweep.terms.vary, job.seed))


def _order(directory: SweepDirectory, job: Job, config: RunConfig) -> str:
    """Write the order of a job's search, in one line: its configuration, and the file that its output goes to.

    It has the sources of the parts that decide, as composing read them: the search composes nothing.
    """
    in_place = replace(config, run=replace(config.run, dir=str(directory.run(job).path)))
    order: dict[str, Json] = {"config": to_json(in_place), "log": str(directory.log(job))}
    if config.code:
        order["parts"] = {code.sha256: to_json(recalled(code.sha256)) for code in config.code.values()}
    return f"{json.dumps(order)}\n"


def keep_order(directory: SweepDirectory, job: Job, config: RunConfig) -> None:
    """Keep the order of a job's search, for a node that `start` finds it on."""
    write_durably(directory.order(job), _order(directory, job, config))


def _begin_log(directory: SweepDirectory, job: Job) -> None:
    """Begin the log of a job with the command that is the same search."""
    run = as_override("run.dir", str(directory.run(job).path))
    command = shlex.join(["tacevo", "search", *overrides_of(directory, job), run])
    directory.log(job).write_text(f"{_TYPED}{command}\n", encoding="utf-8")


def start(directory: SweepDirectory, job: Job) -> subprocess.Popen[bytes]:
    """Start the search of a job by the order that was kept; it ends with this process."""
    _begin_log(directory, job)
    with directory.log(job).open("ab") as output:
        return _begin(
            "tacevo.cli.starter",
            "search",
            str(directory.order(job)),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )


class Starter:
    """A process that runs the searches of jobs, one after the other, each in a process of its own.

    It has imported and read what they need (`tacevo.cli.starter`); it ends with this process, and its search with it.
    """

    def __init__(self, directory: SweepDirectory) -> None:
        self._directory = directory
        self._channel, theirs = socket.socketpair()
        with theirs:
            self.process = _begin(
                "tacevo.cli.starter",
                str(directory.path),  # which `ps` then shows
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
            )

    def start(self, job: Job, config: RunConfig) -> None:
        """Start the search of a job, once that of another has ended."""
        _begin_log(self._directory, job)
        with contextlib.suppress(ConnectionError):  # it was killed, which `poll` tells
            self._channel.sendall(_order(self._directory, job, config).encode())

    def poll(self) -> int | None:
        """Return the exit status of the search that has ended, or of this process; None of one at work."""
        try:
            status = self._channel.recv(_STATUS, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None
        except ConnectionError:  # it was killed before it read its order
            status = b""
        return int(status) if status else self.process.wait()

    @property
    def is_alive(self) -> bool:
        """Whether it can start another: nobody has killed it."""
        return self.process.poll() is None

    def dismiss(self) -> None:
        """Let it end with its search."""
        with contextlib.suppress(OSError):  # it was killed
            self._channel.shutdown(socket.SHUT_WR)

    def close(self) -> None:
        """Hear no more of it."""
        self._channel.close()


def _begin(
    module: str, *arguments: str, stdin: int, stdout: int | IO[bytes], stderr: int | None = None
) -> subprocess.Popen[bytes]:
    """Start a module as a program in a session of its own, which ends with this process."""
    return subprocess.Popen(
        [sys.executable, "-P", "-m", module, *arguments],
        stdin=stdin,
        stdout=stdout,
        stderr=stderr,
        start_new_session=True,
        preexec_fn=partial(_obey, os.getpid()),  # noqa: PLW1509  # takes no lock, and imports nothing
    )


def stop(searches: Iterable[subprocess.Popen[bytes]]) -> None:
    """End searches as Ctrl-C does, or kill them if that takes too long."""
    for search in searches:
        search.terminate()
    deadline = time.monotonic() + GRACE
    for search in searches:
        try:
            search.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            search.kill()
            search.wait()


def end(starters: Sequence[Starter]) -> None:
    """End processes that start searches, and theirs as `stop` does."""
    for starter in starters:
        starter.dismiss()
    stop([starter.process for starter in starters])
    for starter in starters:
        starter.close()


def keep_ending(directory: SweepDirectory, job: Job, status: int) -> None:
    """Keep how a search ended, by its exit status; one that was told to stop neither succeeded nor failed."""
    if status == 0:
        directory.succeed(job)
    elif status not in _INTERRUPTED:
        directory.fail(job, _reason(status, directory.log(job)))


def _obey(parent: int) -> None:
    """End with the parent, which alone hears the signal of a scheduler that every process of a job gets."""
    signal.signal(signal.SIGUSR2, signal.SIG_IGN)  # submitit's: the time is nearly out, or the node is wanted
    end_with(parent)


def _reason(status: int, log: Path) -> str:
    """Say why a search failed."""
    if status < 0:
        return f"killed by signal {-status} ({signal.strsignal(-status)}); memory may have run out"
    said = log.read_text(encoding="utf-8", errors="replace").splitlines()
    lines = [line for line in said if line.strip() and not line.startswith(_TYPED)]
    errors = [line for line in lines if line.startswith(_ERROR)] or lines
    return errors[-1].removeprefix(_ERROR) if errors else f"exit status {status}, without any output"
