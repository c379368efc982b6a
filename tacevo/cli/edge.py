"""What a command sets in its process: text that any terminal takes, signals that end it, and our own `analysis`.

Promises: whichever polite signal asks a command to end, it ends by a KeyboardInterrupt in its main thread; a package
`analysis` that stands before ours on the import path is named, and none of its code runs.
"""

import contextlib
import io
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import FrameType
from typing import Any

from tacevo.errors import ConfigError

#: Seconds after which an interruption that Python ignored comes again.
_AGAIN = 0.05

#: The package beside this one.
_ANALYSIS = Path(__file__).resolve().parents[2] / "analysis"


class Terminated(KeyboardInterrupt):
    """A polite request to end (SIGTERM), which is treated like Ctrl-C."""


@contextlib.contextmanager
def edge() -> Iterator[None]:
    """Set what a command needs in its process; all but the streams is put back at its end."""
    _print_anything()
    finder, hook = _OwnAnalysis(), sys.unraisablehook
    handler = signal.signal(signal.SIGTERM, _terminate)
    sys.unraisablehook = partial(_interrupt_again, hook)
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        sys.unraisablehook = hook
        signal.signal(signal.SIGTERM, handler)


def _print_anything() -> None:
    """Let what a stream's encoding lacks be escaped, and so the name of a file that is not text."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated


def _interrupt_again(otherwise: Callable[[Any], Any], ignored: Any) -> None:
    """Repeat an interruption that came in a destructor or a callback: Python prints what these raise, and goes on."""
    if not isinstance(ignored.exc_value, KeyboardInterrupt):
        otherwise(ignored)
        return
    kind = type(ignored.exc_value)

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise kind

    signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN)


class _OwnAnalysis:
    """A finder of modules that refuses a package `analysis` which is not ours, and leaves the rest to the others."""

    def find_spec(self, name: str, path: Sequence[str] | None = None, target: object = None) -> ModuleSpec | None:
        """Find nothing.

        Raises:
            ConfigError: the package that would be imported is somebody else's.
        """
        if name.partition(".")[0] != "analysis":
            return None
        if path is None:
            spec = PathFinder.find_spec(name)
            path = () if spec is None else tuple(spec.submodule_search_locations or [str(spec.origin)])
        if path and not Path(path[0]).resolve().is_relative_to(_ANALYSIS):
            raise ConfigError(
                path[0],
                place="package analysis",
                expected=f"that of tacevo, {_ANALYSIS}",
                remedy="take its directory out of PYTHONPATH, start in another one, or rename it",
            )
        return None
