"""What a command sets in its process: text that any terminal takes, and signals that end it.

Promises: whichever polite signal asks a command to end, it ends by a KeyboardInterrupt in its main thread.
"""

import contextlib
import io
import signal
import sys
from collections.abc import Callable, Iterator
from functools import partial
from importlib.machinery import PathFinder
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
    hook = sys.unraisablehook
    handler = signal.signal(signal.SIGTERM, _terminate)
    sys.unraisablehook = partial(_interrupt_again, hook)
    try:
        yield
    finally:
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
    if not isinstance(ignored.exc_value, KeyboardInterrupt) or not hasattr(signal, "setitimer"):  # Windows has none
        otherwise(ignored)
        return
    kind = type(ignored.exc_value)

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise kind

    signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN)


def check_analysis() -> None:
    """Refuse a package `analysis` that stands before ours on the import path; none of its code runs.

    Raises:
        ConfigError: there is one.
    """
    spec = PathFinder.find_spec("analysis")
    places = [] if spec is None else list(spec.submodule_search_locations or [str(spec.origin)])
    if places and Path(places[0]).resolve() != _ANALYSIS:
        raise ConfigError(
            places[0],
            place="package analysis",
            expected=f"that of tacevo, {_ANALYSIS}",
            remedy="take its directory out of PYTHONPATH, start in another one, or rename it",
        )
