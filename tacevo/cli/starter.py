"""A process that has imported what a search needs, and forks for each one that it is told to start.

Most of a search that looks its trainings up would else be imports and the reading of its table. Its standard input is a
socket: a line that comes is the order of a search, a line that goes the exit status.
`tacevo.sweeps.search_process.Starter` speaks to it. As `python -m tacevo.cli.starter search FILE`, on a node of Slurm,
it is the one search whose order the file holds.
"""

import argparse
import contextlib
import gc
import json
import os
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Never

from tacevo.cli.app import run
from tacevo.cli.search import run_search
from tacevo.config.plain import from_plain
from tacevo.parts.sources import remember
from tacevo.records import Json
from tacevo.sandbox.kernel import end_with

_INPUT, _OUTPUT, _ERRORS = 0, 1, 2

#: Of a search in which none decides but ours.
_NO_PARTS: Mapping[str, dict[str, str]] = {}

_HEARD = {signal.SIGTERM, signal.SIGCHLD}


def serve() -> None:
    """Start a search for each order, and tell how it ended, until there are no more; SIGTERM goes on to the search."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _HEARD)  # a signal waits until there is a search that it is for
    own = os.getpid()
    for line in sys.stdin:
        order = json.loads(line)
        _read_ahead(order["config"])
        gc.freeze()  # else each search would walk through the table again, and copy its memory
        pid = os.fork()
        if pid == 0:
            _search(own, **order)
        while not (ended := os.waitpid(pid, os.WNOHANG))[0]:
            if signal.sigwait(_HEARD) == signal.SIGTERM:
                os.kill(pid, signal.SIGTERM)  # it was not waited for yet, so this is no other process
        os.write(_INPUT, f"{os.waitstatus_to_exitcode(ended[1])}\n".encode())


def _read_ahead(config: dict[str, Json]) -> None:
    """Read the table of a space, which stays read for all searches in it."""
    with contextlib.suppress(Exception):  # whatever is wrong, the search says in its log
        chosen = from_plain(config)
        if chosen.data.facts.is_looked_up:
            from tacevo.runs.table_answers import table_of

            table_of(chosen)


def _search(
    parent: int, *, config: dict[str, Json], log: str, parts: Mapping[str, dict[str, str]] = _NO_PARTS
) -> Never:
    """Run a search in this process; its output goes to a file."""
    end_with(parent)
    os.setsid()
    os.dup2(os.open(os.devnull, os.O_RDONLY), _INPUT)
    output = os.open(log, os.O_WRONLY | os.O_APPEND)
    os.dup2(output, _OUTPUT)
    os.dup2(output, _ERRORS)

    _obey(config, parts)


def _obey(config: dict[str, Json], parts: Mapping[str, dict[str, str]]) -> Never:
    """Run a search in this process, with the sources of its parts by hash, and end with its exit status."""
    for sha256, sources in parts.items():
        remember(sha256, sources)

    def search(_: argparse.Namespace) -> int:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _HEARD)  # `run` hears them now
        return run_search(from_plain(config))

    options = argparse.Namespace(command=search, interrupted="the same command does what is left")
    sys.exit(run(lambda: options, is_process=True))


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["search", order]:
            read = json.loads(Path(order).read_bytes())
            _obey(read["config"], read.get("parts", _NO_PARTS))
        case _:
            serve()
