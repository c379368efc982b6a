"""Operations that torch cannot repeat bit by bit (child side).

On a CPU they are refused: there are few, and no honest network has needed one. On a GPU they run and are named in the
candidate's record, because the backward pass of adaptive pooling, which every baseline needs, is one of them.
"""

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch

_WITHOUT_FORM = re.compile(r"(\S+) does not have a deterministic implementation")
#: What a name does not contain: the search accepts names only, not free text.
_FOREIGN = re.compile(r"[^\w:.]+", re.ASCII)


@contextmanager
def noting_nondeterminism(device: torch.device) -> Iterator[set[str]]:
    """Make torch use deterministic algorithms; an operation without one fails on a CPU, and is noted elsewhere.

    Raises:
        RuntimeError: from within, on a CPU: the operation has no deterministic form.
    """
    noted: set[str] = set()

    def note(message: Warning | str, *_: Any, **__: Any) -> None:
        if "deterministic" in str(message):
            operation = _WITHOUT_FORM.match(str(message))
            noted.add(_FOREIGN.sub("_", operation[1] if operation else str(message))[:100])

    torch.set_deterministic_debug_mode("error" if device.type == "cpu" else "warn")
    with warnings.catch_warnings():
        if device.type != "cpu":
            warnings.simplefilter("always")
            warnings.showwarning = note
        yield noted
