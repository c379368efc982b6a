"""Which operations of a candidate give other bits on another CPU (child side).

What it promises: it finds every such operation that the probe's passes reach, called by a layer, a function, a method
or autograd, because it watches torch below all of them. What it does not promise: it does not see a branch that the
probe did not take, and the candidate shares this process, so the list is only its claim.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from torch.utils._python_dispatch import TorchDispatchMode

from tacevo.gate.operations import NOT_PORTABLE
from tacevo.sandbox.candidate import call_plainly


@contextmanager
def watching_portability() -> Iterator[set[str]]:
    """Collect, while the context lasts, the names of the operations in `NOT_PORTABLE` that run."""
    watcher = _Watcher()
    with watcher:
        yield watcher.found


class _Watcher(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Sees each call of a kernel, after layers and compound functions have been taken apart."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.found: set[str] = set()

    def __torch_dispatch__(
        self, func: Any, types: Sequence[type], args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        name = _spelling(func, args)
        if name in NOT_PORTABLE:
            self.found.add(name)
        return func(*args, **(kwargs or {}))


call_plainly(_Watcher.__torch_dispatch__)


def _spelling(func: Callable[..., Any], args: tuple[Any, ...]) -> str:
    """Return a kernel's name as in `NOT_PORTABLE`: a power of 0.5 uses the code of the square root."""
    name = str(func).split(".")[1].rstrip("_")
    is_root = name == "pow" and len(args) > 1 and isinstance(args[1], float) and args[1] == 0.5
    return "sqrt" if is_root else name
