"""The tensors that a network, or the text that made it, can reach beside its parameters (child side)."""

import gc
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from types import FunctionType, ModuleType
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from tacevo.sandbox.guards import NAME, OF_TORCH
from tacevo.sandbox.module_parts import attributes, parameters

#: The modules of the classes whose objects are walked; a class of the candidate is from the module of its text.
_WALKED = frozenset({NAME, "builtins", "collections", "functools", "itertools"})
#: The modules of the classes whose objects say their true size.
_BUILT_IN = frozenset({"builtins", "collections"})
#: Values that cannot change; another one takes the place of each.
_PLAIN = (bool, int, float, complex, str, bytes, type(None))


def tensors_outside(network: nn.Module) -> Iterator[Tensor]:
    """Walk the tensors that a network or its text can reach, each once, except its parameters.

    What torch's own layers keep is left out, such as the running statistics of a batch normalisation that saw a batch;
    and what has a history: it was computed from the parameters, as the weight of a normalised layer is.
    """
    for thing in _walked(network):
        if type(thing) in (Tensor, nn.Parameter):
            tensor: Any = thing
            if tensor.layout is torch.strided and not tensor.is_meta and tensor.grad_fn is None:
                yield tensor


def plain_values(network: nn.Module) -> Counter[tuple[type, object]]:
    """Count the numbers, texts and the like that a network or its text can reach, by type and value."""
    return Counter(
        (type(thing), repr(thing)) for holder in _walked(network) for thing in _held(holder) if type(thing) in _PLAIN
    )


def kept(network: nn.Module) -> tuple[list[Tensor], Counter[tuple[str, int]]]:
    """List every tensor that a network or its text can reach but its parameters, and count containers by kind and size.

    As long as the list lives, no later tensor has the identity of one in it.
    """
    things: list[Any] = list(_walked(network))
    tensors = [thing for thing in things if type(thing) in (Tensor, nn.Parameter)]
    sized = (thing for thing in things if type(thing).__module__ in _BUILT_IN and hasattr(type(thing), "__len__"))
    return tensors, Counter((type(thing).__name__, len(thing)) for thing in sized)


def _walked(network: nn.Module) -> Iterator[object]:
    """Walk what can be reached, each thing once, the holder before what it holds."""
    seen = {*map(id, parameters(network))}
    waiting: list[object] = [sys.modules[NAME].__dict__, network]
    while waiting:
        thing = waiting.pop()
        if id(thing) not in seen:
            seen.add(id(thing))
            yield thing
            waiting += _held(thing)


def _held(thing: object) -> Iterable[object]:
    """Return what an object of the candidate's or of Python's holds; nothing of torch's and of modules."""
    kind = type(thing)
    if kind in (Tensor, nn.Parameter):
        return ()
    if issubclass(kind, nn.Module):
        own = attributes(thing)  # type: ignore[arg-type]
        is_torchs = (kind in OF_TORCH or issubclass(kind, _BatchNorm)) and not _is_unused(own)
        return [value for name, value in own.items() if not (is_torchs and name == "_buffers")]
    if kind is FunctionType:  # its globals may be torch's; those of the text are walked anyway
        function: Any = thing
        return (function.__closure__, function.__defaults__, function.__kwdefaults__, function.__dict__)
    is_walked = thing.__module__ == NAME if isinstance(thing, type) else kind.__module__ in _WALKED
    return gc.get_referents(thing) if is_walked and kind is not ModuleType else ()


def _is_unused(own: dict[str, Any]) -> bool:
    """Return whether a normalisation counts its batches, and has seen none: what changes its buffers is another."""
    seen = own["_buffers"].get("num_batches_tracked")
    return type(seen) is Tensor and not seen.any()
