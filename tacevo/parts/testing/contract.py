"""A promise of a part, as a test."""

from collections.abc import Callable
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from traceback import extract_tb

from tacevo.errors import SandboxError, TacevoError


class BrokenError(AssertionError):
    """A part does not keep a promise."""


@dataclass(frozen=True, slots=True)
class Contract:
    """A promise of a part."""

    #: The promise in words, e.g. `gives the same answer to the same question`.
    promise: str
    test: Callable[[], None]

    def __str__(self) -> str:
        return self.promise

    def check(self) -> None:
        """Test it.

        Raises:
            AssertionError: it is broken.
        """
        if fault := self.fault():
            raise AssertionError(f"{self.promise}: {fault}")

    def fault(self) -> str:
        """Test it; return in one line what breaks it, or nothing where it is kept.

        Raises:
            SandboxError: processes cannot be confined here, so nothing can be said.
        """
        try:
            self.test()
        except SandboxError:
            raise
        except (BrokenError, TacevoError) as error:
            return str(error)
        except Exception as error:  # whatever a stranger's code raises
            last = extract_tb(error.__traceback__)[-1]
            return f"it raised {type(error).__name__}: {error} ({Path(last.filename).name}, line {last.lineno})"
        return ""


def require(holds: bool, expected: str, got: object) -> None:
    """Raise a `BrokenError` where something does not hold."""
    if not holds:
        text = str(got)
        raise BrokenError(f"expected {expected}; got {text if len(text) <= 200 else f'{text[:197]}...'}")


def check_frozen(part: object) -> None:
    """Raise a `BrokenError` where a part is no frozen dataclass, whose fields are its settings."""
    made = type(part)
    is_frozen = is_dataclass(made) and made.__dataclass_params__.frozen  # type: ignore[attr-defined]
    require(is_frozen, "@dataclass(frozen=True) above the class", f"{made.__name__} without it")
