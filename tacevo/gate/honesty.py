"""Whether a network is what it says: its names, weights, mode and parameters (child side).

What it promises: an override of a name of `nn.Module` is seen however it was made; so is a weight or a mode that is
another after a pass. What it does not: a network that behaves in the few passes of the probe, on small batches, and
changes its weights or mode later, is not seen. `tacevo.sandbox.candidate` finds what learns without being listed, here
and at each step of a training.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain

import torch
from torch import Tensor, nn

from tacevo.gate.policy.allowed import MODULE_NAMES
from tacevo.records import Reason
from tacevo.sandbox.candidate import NAME, CandidateError
from tacevo.sandbox.network import attributes, modules, parameters, switch

_CLASS_ATTRIBUTES = vars(type)["__dict__"]  # a metaclass may define its own `__dict__`


def check_names(network: nn.Module) -> None:
    """Check that no module of a network has its own meaning for a name of `nn.Module`.

    Raises:
        CandidateError: one has, in its class or on the object.
    """
    stored = vars(nn.Module()).keys()
    for module in modules(network):
        kinds = map(_CLASS_ATTRIBUTES.__get__, type.mro(type(module)))
        written = (kind for kind in kinds if kind.get("__module__") == NAME)
        own = (name for name in attributes(module) if name not in stored)
        found = sorted(MODULE_NAMES.intersection(chain(own, *written)))
        if found:
            detail = f"expected nn.Module's own {found[0]}; got another one in {type(module).__name__}"
            raise CandidateError(Reason.redefines_module, detail)


@contextmanager
def unchanged(network: nn.Module, *, training: bool) -> Iterator[list[nn.Parameter]]:
    """Switch a network's mode, and see that what runs within leaves names, mode and parameters as they are.

    Buffers may change, as the statistics of a batch normalisation do.

    Yields:
        The parameters.

    Raises:
        CandidateError: something was changed.
    """
    switch(network, training=training)
    listed = list(modules(network))
    before = parameters(network)
    bits = [_bits(parameter).clone() for parameter in before]
    yield before
    after = parameters(network)
    if [*map(id, after)] != [*map(id, before)]:
        detail = "expected the parameters that the constructor made; got others after a pass; make all of them there"
        raise CandidateError(Reason.changes_its_weights, detail)
    if not all(map(torch.equal, map(_bits, after), bits)):
        detail = f"expected the same weights before and after a pass with training={training}; got others"
        raise CandidateError(Reason.changes_its_weights, detail)
    if any(attributes(module)["training"] is not training for module in listed):
        detail = f"expected training={training} in every module after a pass; got another value"
        raise CandidateError(Reason.changes_its_mode, detail)
    check_names(network)


def _bits(tensor: Tensor) -> Tensor:
    """Return a tensor's bytes, so that equal NaNs are equal."""
    return Tensor.detach(tensor).contiguous().reshape(-1).view(torch.uint8)
