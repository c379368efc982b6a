"""The graph of a network, recorded while one forward pass runs (child side).

What it promises: a layer and its function give the same node; control flow, loops, shared modules and plain Python
containers are followed as they ran; a layer that raised is not a node, and what runs after it is recorded. What it does
not promise: a branch that this input did not take is not recorded, and an in-place write through a view is recorded for
the view only. Symbolic tracing (torch.fx, torch.export) would refuse data-dependent control flow, which models write.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.modules import module as hooks
from torch.overrides import TorchFunctionMode

from tacevo.gate.operations import CONVOLUTIONS, WEIGHTED, is_factory, is_transparent, operation
from tacevo.gate.steps import Settings, StepRecorder, of_call, of_layer
from tacevo.profile import Graph, Node, Step
from tacevo.sandbox.module_parts import parameters, switch

#: Modules of torch.nn that only call others; every other class of torch.nn is one layer.
_CONTAINERS = (
    nn.Sequential,
    nn.Transformer,
    nn.TransformerEncoder,
    nn.TransformerEncoderLayer,
    nn.TransformerDecoder,
    nn.TransformerDecoderLayer,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Trace:
    """One forward pass."""

    #: The value that the network returned.
    output: Any
    graph: Graph
    #: The pass with activations, shapes and settings, at most `tacevo.profile.MOST_STEPS` of them.
    steps: tuple[Step, ...]
    #: The steps that the output comes from.
    ends: tuple[int, ...]


def trace(model: nn.Module, images: Tensor) -> Trace:
    """Run one forward pass in eval mode without gradients and record what it did; the network is left in eval mode.

    Images are of shape (N, channels, height, width).

    Raises:
        Exception: what the network raises.
    """
    switch(model, training=False)
    recorder = _Recorder(model, images)
    with torch.no_grad(), recorder.watching_layers(), recorder:
        output = model(images)
    steps = recorder.steps
    return Trace(output=output, graph=recorder.graph(), steps=tuple(steps.steps), ends=steps.behind(_tensors(output)))


class _Recorder(TorchFunctionMode):
    """Turns calls into nodes, and tensors that travel between them into edges."""

    def __init__(self, model: nn.Module, images: Tensor) -> None:
        super().__init__()
        self._nodes: list[Node] = []
        self._edges: set[tuple[int, int]] = set()
        # Keyed by id, because == of tensors is element by element. `_alive` keeps ids from being reused.
        self._alive: list[Tensor] = [images]
        self._producers: dict[int, frozenset[int]] = {id(images): frozenset()}
        self._parameters = {id(parameter): id(parameter) for parameter in parameters(model)}
        self._convolutions: dict[int, tuple[int, float]] = {}
        self._linears: dict[int, int] = {}
        self._last_linear: int | None = None
        self._layers_entered = 0
        self.steps = StepRecorder(images)

    def graph(self) -> Graph:
        """Return what was recorded so far."""
        return Graph(
            nodes=tuple(self._nodes),
            edges=tuple(sorted(self._edges)),
            channels=tuple(channels for channels, _ in self._convolutions.values()),
            kernels=tuple(kernel for _, kernel in self._convolutions.values()),
            hidden=tuple(width for key, width in self._linears.items() if key != self._last_linear),
        )

    @contextmanager
    def watching_layers(self) -> Iterator[None]:
        """Record the layers of torch.nn as one node each while the context lasts."""
        # Two hooks after the layer, in this order: only the second is called after an error, and it gets no keywords.
        handles = (
            hooks.register_module_forward_pre_hook(self._enter_layer),
            hooks.register_module_forward_hook(self._record_layer, with_kwargs=True),
            hooks.register_module_forward_hook(self._leave_layer, always_call=True),
        )
        try:
            yield
        finally:
            for handle in handles:
                handle.remove()

    def __torch_function__(
        self, func: Callable[..., Any], types: Iterable[type], args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        kwargs = kwargs or {}
        output = func(*args, **kwargs)
        if self._layers_entered:
            return output
        name = getattr(func, "__name__", "")
        op = operation(name)
        inputs = list(_tensors((args, kwargs)))
        if op == "setitem":
            self._follow(op, inputs, args[0], key=None, settings={})
            return output
        if not name.endswith("_") and not is_transparent(op):
            output = _distinct(output, inputs)
        settings = of_call(op, args, kwargs, inputs)
        self._follow(op, inputs, output, key=self._root(inputs, dimensions=2), settings=settings)
        return output

    def _enter_layer(self, layer: nn.Module, args: tuple[Any, ...]) -> None:
        if _layer_class(layer) is not None:
            self._layers_entered += 1

    def _record_layer(self, layer: nn.Module, args: tuple[Any, ...], kwargs: dict[str, Any], output: Any) -> Any:
        owner = _layer_class(layer)
        if owner is None or self._layers_entered > 1:
            return output
        op = operation(owner.__name__)
        inputs = list(_tensors((args, kwargs)))
        if not is_transparent(op):
            output = _distinct(output, inputs)
        weight = getattr(layer, "weight", None)
        self._follow(op, [*inputs, *_tensors(weight)], output, key=id(layer), settings=of_layer(op, layer))
        return output

    def _leave_layer(self, layer: nn.Module, args: tuple[Any, ...], output: Any) -> None:
        """Note that a layer ended, also by an error, which the network may catch to continue without the layer."""
        if _layer_class(layer) is not None:
            self._layers_entered -= 1

    def _follow(self, op: str, inputs: list[Tensor], output: Any, *, key: int | None, settings: Settings) -> None:
        """Follow data from inputs to outputs, through a new node where the call is an operation.

        The inputs are every tensor that the call was given, its weight included. The key says which weights it used;
        None where it used none of two or more dimensions.
        """
        results = list(_tensors(output))
        sources = [self._producers[id(tensor)] for tensor in inputs if id(tensor) in self._producers]
        if not results or (sources and is_factory(op)):
            return
        if not sources:
            self._derive(inputs, results)
            return
        producers = frozenset[int]().union(*sources)
        weights = key if op in WEIGHTED else None
        if not is_transparent(op):
            index = len(self._nodes)
            width = 0 if weights is None else self._note_layer(op, inputs, results[0], weights)
            self._nodes.append(Node(op=op, weighted=weights is not None, width=width))
            self._edges |= {(producer, index) for producer in producers}
            producers = frozenset({index})
        self.steps.follow(op, inputs, results, weighted=weights is not None, settings=settings)
        self._producers |= {id(result): producers for result in results}
        self._alive += results

    def _note_layer(self, op: str, inputs: list[Tensor], result: Tensor, key: int) -> int:
        """Record the properties of a weighted layer once, however often it is called; return its width."""
        rank = CONVOLUTIONS.get(op)
        if rank is None:
            width = result.shape[-1]
            if op == "linear":
                self._linears[key] = width
                self._last_linear = key
            return width
        width = result.shape[-1 - rank]
        weight = next(tensor for tensor in reversed(inputs) if tensor.dim() == rank + 2)
        self._convolutions[key] = (width, sum(weight.shape[2:]) / rank)
        return width

    def _derive(self, inputs: list[Tensor], results: list[Tensor]) -> None:
        """Record that tensors which do not depend on the input were made from a parameter."""
        root = self._root(inputs, dimensions=0)
        if root is not None:
            self._parameters |= {id(result): root for result in results}
            self._alive += results

    def _root(self, inputs: list[Tensor], *, dimensions: int) -> int | None:
        """Find the parameter behind the first input with at least these dimensions that is made from one."""
        own = (tensor for tensor in inputs if tensor.dim() >= dimensions and id(tensor) in self._parameters)
        return next((self._parameters[id(tensor)] for tensor in own), None)


def _layer_class(module: nn.Module) -> type[nn.Module] | None:
    """Find the class of torch.nn that defines a layer's forward pass; None for containers and for custom modules."""
    owner = next(kind for kind in type(module).__mro__ if "forward" in vars(kind))
    is_layer = owner.__module__.startswith("torch.nn.modules.") and owner not in _CONTAINERS
    return owner if is_layer and issubclass(owner, nn.Module) else None


def _distinct(output: Any, inputs: list[Tensor]) -> Any:
    """Return a view of an output that is the input object itself (dropout in eval mode), so that ids differ."""
    if isinstance(output, Tensor) and any(output is tensor for tensor in inputs):
        return output.view_as(output)
    return output


def _tensors(value: Any) -> Iterator[Tensor]:
    """Walk the tensors in nested tuples, lists and dictionaries."""
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _tensors(item)
    elif isinstance(value, dict):
        yield from _tensors(list(value.values()))
