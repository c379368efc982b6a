"""A process that has imported what a search needs, and forks for each one that it is told to start.

Half of a search that looks its trainings up would else be imports. Its standard input is a socket: a line that comes is
the order of a search, a line that goes the exit status. `tacevo.sweeps.search_process.Starter` speaks to it.
"""

import json
import os
import signal
import sys
from typing import Never

import tacevo.cli.search  # noqa: F401  # what a search needs
from tacevo.cli.app import main
from tacevo.sandbox.kernel import end_with

_INPUT, _OUTPUT, _ERRORS = 0, 1, 2

_HEARD = {signal.SIGTERM, signal.SIGCHLD}


def serve() -> None:
    """Start a search for each order, and tell how it ended, until there are no more; SIGTERM goes on to the search."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _HEARD)  # a signal waits until there is a search that it is for
    own = os.getpid()
    for line in sys.stdin:
        pid = os.fork()
        if pid == 0:
            _search(own, **json.loads(line))
        while not (ended := os.waitpid(pid, os.WNOHANG))[0]:
            if signal.sigwait(_HEARD) == signal.SIGTERM:
                os.kill(pid, signal.SIGTERM)  # it was not waited for yet, so this is no other process
        os.write(_INPUT, f"{os.waitstatus_to_exitcode(ended[1])}\n".encode())


def _search(parent: int, *, arguments: list[str], log: str) -> Never:
    """Run a command in this process; its output goes to a file."""
    end_with(parent)
    os.setsid()
    os.dup2(os.open(os.devnull, os.O_RDONLY), _INPUT)
    output = os.open(log, os.O_WRONLY | os.O_APPEND)
    os.dup2(output, _OUTPUT)
    os.dup2(output, _ERRORS)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _HEARD)
    sys.argv[1:] = arguments
    sys.exit(main())


if __name__ == "__main__":
    serve()
