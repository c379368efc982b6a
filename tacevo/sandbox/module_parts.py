"""A network's parts, listed, switched and saved without asking the network (child side).

A candidate's class may give any meaning to `parameters`, `train` or `state_dict`. These functions read the dictionaries
that `nn.Module` keeps for each module, call nothing of the candidate's, and answer as the methods of an honest network
do, in the same order. They raise KeyError or TypeError where a module does not hold what `nn.Module` makes it hold.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.graph import Node, get_gradient_edge

_ATTRIBUTES = vars(nn.Module)["__dict__"]  # taken before any candidate runs; a class may define its own `__dict__`


def attributes(module: nn.Module) -> dict[str, Any]:
    """Return the attributes of one module as it stores them."""
    own: dict[str, Any] = _ATTRIBUTES.__get__(module)
    return own


def modules(network: nn.Module) -> Iterator[nn.Module]:
    """Walk the network and all modules below it, each once, parents first, as `nn.Module.modules` does."""
    seen: set[int] = set()
    waiting = [network]
    while waiting:
        module = waiting.pop()
        if id(module) not in seen:
            seen.add(id(module))
            yield module
            waiting += [child for _, child in reversed(_held(module, "_modules"))]


def parameters(network: nn.Module) -> list[nn.Parameter]:
    """List the parameters, each once, as `nn.Module.parameters` does; one of another class could misreport itself."""
    known: dict[int, nn.Parameter] = {}
    for module in modules(network):
        for name, parameter in _held(module, "_parameters"):
            if type(parameter) is not nn.Parameter:
                raise TypeError(f"expected {name} to be an nn.Parameter; got {type(parameter).__name__}")
            known.setdefault(id(parameter), parameter)
    return list(known.values())


def state(network: nn.Module) -> dict[str, Tensor]:
    """Return parameters and persistent buffers by their names, as `nn.Module.state_dict` does.

    Raises:
        RecursionError: a module holds itself.
    """
    return dict(_state(network, ""))


def switch(network: nn.Module, *, training: bool) -> None:
    """Put every module into training or evaluation mode, as `nn.Module.train` does."""
    for module in modules(network):
        attributes(module)["training"] = training


def graph_nodes(output: Tensor) -> Iterator[Node]:
    """Walk the nodes of the graph that an output was computed by, each once.

    Raises:
        ValueError: the output does not require a gradient.
    """
    waiting = [get_gradient_edge(output).node]
    seen = {*waiting}
    while waiting:
        node = waiting.pop()
        yield node
        for following, _ in node.next_functions:  # in their order, so that the first leaf is the same in every process
            if following is not None and following not in seen:
                seen.add(following)
                waiting.append(following)


def leaves(output: Tensor) -> Iterator[Tensor]:
    """Find the tensors that an output learns by: those at which its graph ends; raises as `graph_nodes` does."""
    return (node.variable for node in graph_nodes(output) if hasattr(node, "variable"))


def bits(tensor: Tensor) -> Tensor:
    """Return a tensor's bytes, so that equal NaNs are equal."""
    return Tensor.detach(tensor).contiguous().reshape(-1).view(torch.uint8)


def equal(some: Tensor, others: Tensor) -> bool:
    """Compare bytes as `bits` returns them, eight at a time: torch's own comparison takes far longer."""
    left, right = some.numpy(), others.numpy()
    whole = left.size // 8 * 8
    return left.size == right.size and bool(
        np.array_equal(left[:whole].view(np.int64), right[:whole].view(np.int64))
        and np.array_equal(left[whole:], right[whole:])
    )


def _state(module: nn.Module, prefix: str) -> Iterator[tuple[str, Tensor]]:
    transient = attributes(module)["_non_persistent_buffers_set"]
    yield from ((prefix + name, value) for name, value in _held(module, "_parameters"))
    buffers = _held(module, "_buffers")
    yield from ((prefix + name, value) for name, value in buffers if not set.__contains__(transient, name))
    for name, child in _held(module, "_modules"):
        yield from _state(child, f"{prefix}{name}.")


def _held(module: nn.Module, kind: str) -> list[tuple[str, Any]]:
    """List what a module holds of a kind, without entries that are None."""
    entries = dict.items(attributes(module)[kind])  # not `.items()`, which a subclass of dict could define
    return [(name, value) for name, value in entries if value is not None]
