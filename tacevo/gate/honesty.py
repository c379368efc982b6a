"""Whether a network is what it says: its names, weights, mode and parameters (child side).

What it promises: it finds every override of a name of `nn.Module`, and every weight or mode that a pass changes. What
it does not promise: it does not find a network that changes its weights or mode later, or only in larger batches than
the few of the probe. `tacevo.sandbox.candidate` finds what learns without being listed, here and at each step of a
training.
"""

from collections import Counter
from collections.abc import Container, Iterator
from contextlib import contextmanager
from itertools import islice
from types import FunctionType

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from tacevo.records import Reason
from tacevo.sandbox.attributes import MODULE_NAMES
from tacevo.sandbox.guards import OF_TORCH, CandidateError, attributes_of_class, check_shared
from tacevo.sandbox.module_parts import attributes, bits, equal, modules, parameters, state, switch
from tacevo.sandbox.outside import tensors_outside

# A metaclass may define its own `__mro__`.
_CLASS_ORDER = vars(type)["__mro__"]
#: Names that decide what a module answers; `object` has the last one.
_NAMES = MODULE_NAMES | {"__getattribute__"}
#: The largest number of tensors outside the parameters that are looked at.
_MOST_TENSORS = 10_000
#: Keeps what watches a candidate's kernels from being called for ours, which takes most of their time.
unwatched = torch._C._DisableTorchDispatch
#: The code that `parametrize` writes into each class that it makes.
_PARAMETRIZED = [part for part in parametrize._inject_new_class.__code__.co_consts if hasattr(part, "co_code")]


def check_names(network: nn.Module) -> None:
    """Check that no module of a network has its own meaning for a name of `nn.Module`.

    What a class says of itself is not used. The classes that a training calls must be what they were before the
    candidate ran (`build` compares all), and a new class or an object must not define any of these names.

    Raises:
        CandidateError: one does.
    """
    check_shared(every=False)
    stored = vars(nn.Module()).keys()
    honest = {id(object), *map(id, OF_TORCH)}  # ids of classes, which live on; a class may define its own hash
    for module in modules(network):
        kinds = [kind for kind in _CLASS_ORDER.__get__(type(module)) if id(kind) not in honest]
        redefined = {name for kind in kinds for name in _redefined(kind)}
        redefined |= _NAMES & attributes(module).keys() - stored
        if redefined:
            detail = f"expected nn.Module's own {min(redefined)}; got another one in {type(module).__name__}"
            raise CandidateError(Reason.redefines_module, detail)
        honest.update(map(id, kinds))


def _redefined(kind: type) -> Iterator[str]:
    """Yield the names that a new class defines, except by torch's own parametrization."""
    own = attributes_of_class(kind)
    for name in _NAMES & own.keys():
        value = own[name]
        if not (type(value) is FunctionType and value.__code__ in _PARAMETRIZED):
            yield name


@contextmanager
def unchanged(network: nn.Module, *, training: bool) -> Iterator[list[nn.Parameter]]:
    """Switch a network's mode, and check that what runs within leaves names, mode and parameters as they are.

    Buffers may change, as the statistics of a batch normalisation do (see `count_learnt`).

    Yields:
        The parameters.

    Raises:
        CandidateError: something was changed.
    """
    switch(network, training=training)
    listed = list(modules(network))
    before = parameters(network)
    with unwatched():
        copies = [bits(parameter).clone() for parameter in before]
    yield before
    after = parameters(network)
    if [*map(id, after)] != [*map(id, before)]:
        detail = (
            "expected the parameters that the constructor made; got others after a pass; make all in the constructor"
        )
        raise CandidateError(Reason.changes_its_weights, detail)
    with unwatched():
        is_same = all(map(equal, map(bits, after), copies))
    if not is_same:
        detail = f"expected the same weights before and after a pass with training={training}; got others"
        raise CandidateError(Reason.changes_its_weights, detail)
    if any(attributes(module)["training"] is not training for module in listed):
        detail = f"expected training={training} in every module after a pass; got another value"
        raise CandidateError(Reason.changes_its_mode, detail)
    check_names(network)


#: The bits of tensors by their ids; the tensors are kept, so that no id is used again.
_State = dict[int, tuple[Tensor, Tensor]]


def state_outside(network: nn.Module) -> _State:
    """Copy what a network, or the text that made it, keeps in tensors outside its parameters.

    These are buffers, and tensors in attributes, lists, closures and globals. What torch's own layers keep is left out,
    such as the running statistics of a batch normalisation that saw a batch.
    """
    with unwatched():
        found = islice(tensors_outside(network), _MOST_TENSORS)
        return {id(tensor): (tensor, bits(tensor).clone()) for tensor in found}


def count_learnt(before: _State, after: _State) -> int:
    """Count the values that changed, in place or by another tensor of the same shape in the place of one.

    An activation that is kept is not counted where its shape follows the size of the batch, and that was another one.
    """
    both = before.keys() & after.keys()
    with unwatched():
        changed = sum(after[key][0].numel() for key in both if not equal(after[key][1], before[key][1]))
        gone, new = _values(before, both), _values(after, both)
    # What is made again with equal bits, such as a grid in each pass, did not change.
    lost, made = (Counter(kind[:2] for kind in kinds.elements()) for kinds in (gone - new, new - gone))
    return changed + sum(shape.numel() * number for (shape, _), number in (lost & made).items())


def _values(kept: _State, without: Container[int]) -> Counter[tuple[torch.Size, torch.dtype, bytes]]:
    """Count tensors by shape, type and bits."""
    others = (pair for key, pair in kept.items() if key not in without)
    return Counter((tensor.shape, tensor.dtype, copy.numpy().tobytes()) for tensor, copy in others)


def copied_state(network: nn.Module) -> dict[str, tuple[torch.dtype, torch.Size, bytes]]:
    """Copy type, shape and bits of every weight and persistent buffer, by name."""
    with unwatched():
        return {
            name: (value.dtype, value.shape, bits(value).numpy().tobytes()) for name, value in state(network).items()
        }
