"""Every exception a caller of tacevo may want to catch.

    TacevoError
    ├── ConfigError          a setting the user wrote cannot be used (also a ValueError)
    ├── PartError            a part that a user brought raised, hung, or decided what it may not
    ├── DataError            a data set is missing, broken or does not fit the task
    ├── StoreError           a store entry is damaged or of an unknown schema
    ├── RunError             a run directory cannot be used as asked
    │   └── IncomparableError  the runs of a sweep differ in what a comparison must hold fixed
    ├── BundleError          a published run is damaged, was edited or could do harm
    ├── DivergenceError      a recomputed ledger line differs from the recorded one
    ├── LLMError
    │   ├── BudgetError      the next request could cost more than the user allows
    │   ├── CacheMissError   replay met a request that was never recorded
    │   └── TransportError   the model could not be reached, after all retries
    └── SandboxError         the sandbox itself is broken (never: a candidate is)

A candidate that fails is a value, `tacevo.records.Rejection`, and never an exception.
"""

import contextlib
from collections.abc import Callable, Iterator


def escaped(text: str, kept: str = "") -> str:
    r"""Write each character that cannot be printed, but for those that are kept, as an escape such as `\x1b`."""
    return "".join(
        letter if letter.isprintable() or letter in kept else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )


class TacevoError(Exception):
    r"""Anything tacevo raises on purpose.

    Its text reads `PLACE: expected EXPECTED; got GOT; REMEDY`; what is not given is left out. It is one line: a line
    break in it, which may be a stranger's, is written as `\n`, and so are controls. Code that knows more than the code
    that raised it sets `place` or `remedy` on the error and raises it again.

    Args:
        got: what came, or what happened.
        place: where: a configuration key, a file, a line of it.
        expected: what can be used there, e.g. `an integer of at least 1`.
        remedy: what the user can do, as an order.
    """

    def __init__(self, got: str, *, place: str = "", expected: str = "", remedy: str = "") -> None:
        super().__init__(got)  # the only argument, so that an error survives pickling from a worker
        self.got = got
        self.place = place
        self.expected = expected
        self.remedy = remedy

    def __str__(self) -> str:
        """Return the fields as one sentence."""
        came = f"expected {self.expected}; got {self.got}" if self.expected else self.got
        return escaped((f"{self.place}: " if self.place else "") + came + (f"; {self.remedy}" if self.remedy else ""))


class ConfigError(TacevoError, ValueError):
    """A setting cannot be used; the message names the key as the user wrote it."""


class PartError(TacevoError):
    """A part that a user brought is at fault; the message names the setting that chose it, and its method."""


class DataError(TacevoError):
    """A data set is missing, unreadable, or does not fit the task."""


class StoreError(TacevoError):
    """A store entry is damaged, or was written under a schema this version does not know."""


class RunError(TacevoError):
    """A run directory is missing something, or holds another run."""


class IncomparableError(RunError):
    """The jobs of a sweep cannot be compared; each may be sound."""


class BundleError(TacevoError):
    """A published run is refused; the message names the place in it."""


class DivergenceError(TacevoError):
    """A recomputed ledger line differs from the recorded one; the message names the first difference."""


class LLMError(TacevoError):
    """A request for a completion failed."""


class BudgetError(LLMError):
    """No further request fits the budget; what was asked before is recorded."""


class CacheMissError(LLMError):
    """Replay asked for an answer that was never recorded."""


class TransportError(LLMError):
    """The model could not be reached, after all retries; nothing was recorded."""


class SandboxError(TacevoError):
    """The sandbox could not do its work; no verdict about any candidate follows from this."""


@contextlib.contextmanager
def telling(is_kept: Callable[[], bool]) -> Iterator[None]:
    """Let an interrupt say whether something is kept by then; the command prints its words."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        words = "what was computed is kept" if is_kept() else "nothing is finished yet"
        raise type(interrupt)(f"{words}, and the same command continues") from interrupt  # SIGTERM has its own status
