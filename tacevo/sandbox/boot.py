"""The zygote's first step: set what a process can only inherit, then start Python again as the zygote."""

import os
import signal
import sys
from typing import NoReturn

from tacevo.sandbox.kernel import fix_addresses

#: Code for `python -c`; its arguments are the zygote's socket, then the import path.
_BOOT = "import sys; sys.path[:] = sys.argv[2:]; from tacevo.sandbox.boot import boot; boot()"
_ZYGOTE = "import sys; sys.path[:] = sys.argv[2:]; from tacevo.sandbox.zygote import main; main(int(sys.argv[1]))"


def command(socket: int) -> list[str]:
    """Return the command line of a zygote that serves the socket and has the import path of this process."""
    return _python(_BOOT, str(socket), *map(os.path.abspath, sys.path))


def boot() -> NoReturn:
    """Become the zygote.

    From here on, the signals by which people and batch systems cancel a run are ignored. They reach every process, and
    a candidate killed by one would be rejected for it. When the search ends, everything below it ends too.
    """
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    fix_addresses()
    arguments = _python(_ZYGOTE, *sys.argv[1:])
    os.execv(arguments[0], arguments)


def _python(code: str, *arguments: str) -> list[str]:
    """Return a command that runs code without the user's packages or this directory on the path, or bytecode."""
    return [sys.executable, "-s", "-P", "-B", "-c", code, *arguments]
