"""Whether a network is what it says: its names, weights, mode and parameters (child side).

What it promises: it finds every override of a name of `nn.Module`, and every weight or mode that a pass changes. What
it does not promise: it does not find a network that changes its weights or mode later, or only in larger batches than
the few of the probe. `tacevo.sandbox.candidate` finds what learns without being listed, here and at each step of a
training.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from types import FunctionType
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from tacevo.gate.policy.allowed import MODULE_NAMES
from tacevo.records import Reason
from tacevo.sandbox.candidate import CandidateError
from tacevo.sandbox.network import attributes, modules, parameters, switch

_CLASS_ATTRIBUTES = vars(type)["__dict__"]  # a metaclass may define its own `__dict__`

_CLASS_ORDER = vars(type)["__mro__"]

#: Names that decide what a module answers; `object` has the last one.
_NAMES = MODULE_NAMES | {"__getattribute__"}


def _meanings(kind: type) -> dict[str, Any]:
    """Return these names with what one class itself defines them as."""
    own = _CLASS_ATTRIBUTES.__get__(kind)
    return {name: own[name] for name in _NAMES & own.keys()}


def _with_subclasses(kind: type) -> Iterator[type]:
    yield kind
    subclasses: list[type] = kind.__subclasses__()
    for below in subclasses:
        yield from _with_subclasses(below)


#: The meanings in torch's own modules, read before a candidate runs, which could change these classes.
_TORCH = {kind: _meanings(kind) for kind in (object, *_with_subclasses(nn.Module))}

#: Keeps what watches a candidate's kernels from being called for ours, which takes most of their time.
_unwatched = torch._C._DisableTorchDispatch

#: What `parametrize` writes into each class that it makes, as code.
_PARAMETRIZED = [part for part in parametrize._inject_new_class.__code__.co_consts if hasattr(part, "co_code")]


def check_names(network: nn.Module) -> None:
    """Check that no module of a network has its own meaning for a name of `nn.Module`.

    What a class says of itself is not used. A name must mean what it meant in this class before the candidate ran, and
    a new class must not define any.

    Raises:
        CandidateError: a module has, in its class or on the object.
    """
    stored = vars(nn.Module()).keys()
    honest: set[int] = set()  # ids of classes, which their modules keep alive; a class may define its own hash
    for module in modules(network):
        kinds = [kind for kind in _CLASS_ORDER.__get__(type(module)) if id(kind) not in honest]
        found = {name for kind in kinds for name in _redefined(kind)}
        found |= _NAMES & attributes(module).keys() - stored
        if found:
            detail = f"expected nn.Module's own {min(found)}; got another one in {type(module).__name__}"
            raise CandidateError(Reason.redefines_module, detail)
        honest.update(map(id, kinds))


def _redefined(kind: type) -> Iterator[str]:
    """Yield the names that mean something else in one class than in torch's own."""
    before = _TORCH.get(kind, {})
    for name, value in _meanings(kind).items():
        is_parametrized = type(value) is FunctionType and value.__code__ in _PARAMETRIZED
        if not is_parametrized and not (name in before and before[name] is value):
            yield name


@contextmanager
def unchanged(network: nn.Module, *, training: bool) -> Iterator[list[nn.Parameter]]:
    """Switch a network's mode, and check that what runs within leaves names, mode and parameters as they are.

    Buffers may change, as the statistics of a batch normalisation do.

    Yields:
        The parameters.

    Raises:
        CandidateError: something was changed.
    """
    switch(network, training=training)
    listed = list(modules(network))
    before = parameters(network)
    with _unwatched():
        bits = [_bits(parameter).clone() for parameter in before]
    yield before
    after = parameters(network)
    if [*map(id, after)] != [*map(id, before)]:
        detail = (
            "expected the parameters that the constructor made; got others after a pass; make all in the constructor"
        )
        raise CandidateError(Reason.changes_its_weights, detail)
    with _unwatched():
        are_equal = all(map(torch.equal, map(_bits, after), bits))
    if not are_equal:
        detail = f"expected the same weights before and after a pass with training={training}; got others"
        raise CandidateError(Reason.changes_its_weights, detail)
    if any(attributes(module)["training"] is not training for module in listed):
        detail = f"expected training={training} in every module after a pass; got another value"
        raise CandidateError(Reason.changes_its_mode, detail)
    check_names(network)


def _bits(tensor: Tensor) -> Tensor:
    """Return a tensor's bytes, so that equal NaNs are equal."""
    return Tensor.detach(tensor).contiguous().reshape(-1).view(torch.uint8)
