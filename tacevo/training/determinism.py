"""Operations that torch cannot repeat bit by bit (child side).

On a CPU they are refused: there are few, and no honest network has needed one. On a GPU there are more, of which those
that nearly every network needs are replaced (`tacevo.training.pooling`); the others run, and are named in the
candidate's record.
"""

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import torch

from tacevo.training.pooling import repeating_pooling

_WITHOUT_FORM = re.compile(r"(\S+) does not have a deterministic implementation")
#: The characters that a name does not contain: the search accepts names only, not free text.
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

    is_on_cpu = device.type == "cpu"
    torch.set_deterministic_debug_mode("error" if is_on_cpu else "warn")
    with nullcontext() if is_on_cpu else repeating_pooling(device), warnings.catch_warnings():
        if not is_on_cpu:
            warnings.simplefilter("always")
            warnings.showwarning = note
        yield noted
