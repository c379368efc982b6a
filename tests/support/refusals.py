"""What an error says, field by field, so that a sentence may change and its test need not."""

import contextlib
from collections.abc import Iterator

import pytest

from tacevo.errors import TacevoError


@contextlib.contextmanager
def refused(
    kind: type[TacevoError], *, place: str = "", expected: str = "", got: str = "", remedy: str = ""
) -> Iterator[pytest.ExceptionInfo[TacevoError]]:
    """Expect an error of this class, each given text within the field of its name; what was caught is yielded."""
    with pytest.raises(kind) as caught:
        yield caught
    error = caught.value
    for field, words in {"place": place, "expected": expected, "got": got, "remedy": remedy}.items():
        assert words in getattr(error, field), f"{field} of {error!r} is {getattr(error, field)!r}"
