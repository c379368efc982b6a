"""A process that has imported what a search needs, and forks for each one that it is told to start.

Half of a search that looks its trainings up would else be imports. A line of standard input is an order, a line of
standard output the exit status of its search; `tacevo.sweeps.search_process.Starter` speaks to it.
"""

import json
import os
import signal
import sys
from types import FrameType
from typing import Never

import tacevo.cli.search  # noqa: F401  # what a search needs
from tacevo.cli.app import main
from tacevo.sandbox.kernel import end_with

_INPUT, _OUTPUT, _ERRORS = 0, 1, 2


def serve() -> None:
    """Start a search for each order, and report its end, until there are no more; SIGTERM goes on to the search."""
    running = set[int]()

    def pass_on(number: int, _: FrameType | None) -> None:
        for pid in running:
            os.kill(pid, number)

    signal.signal(signal.SIGTERM, pass_on)
    own = os.getpid()
    for line in sys.stdin:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})  # until it reaches the search, or its own handler
        pid = os.fork()
        if pid == 0:
            _search(own, **json.loads(line))
        running.add(pid)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        running.clear()
        print(status, flush=True)


def _search(parent: int, *, arguments: list[str], log: str) -> Never:
    """Run a command in this process; its output goes to a file."""
    end_with(parent)
    os.setsid()
    os.dup2(os.open(os.devnull, os.O_RDONLY), _INPUT)
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
    os.dup2(output, _OUTPUT)
    os.dup2(output, _ERRORS)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    sys.argv[1:] = arguments
    sys.exit(main())


if __name__ == "__main__":
    serve()
