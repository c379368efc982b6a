"""The steps of a traced pass: the calls that the graph leaves out or simplifies, for motifs (child side).

What it promises: every node of the graph that gets values of the image is a step, and so is every simple activation;
changes of shape are not, data flows through them. Unlike the graph, steps know that `gate.expand_as(x)` has no values
of x. Of a longer pass, the first `MOST_STEPS` calls are recorded.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from torch import Tensor, nn

from tacevo.gate.operations import CONVOLUTIONS, activation, is_transparent
from tacevo.profile import MOST_OPERANDS, MOST_STEPS, Step

#: Places of strides and groups in the functions of convolutions: after input, weight, bias; after padding and one more.
_STRIDE, _GROUPS = 3, 6
#: The probability that torch's dropout functions take where a call names no probability.
_DROPOUT = 0.5
#: Calls that take no values from their second tensor, only its shape or type.
_LIKE = {"expand_as", "view_as", "reshape_as", "type_as"}
#: The settings of a call, by the names of the fields of a `Step`: `kernel`, `stride`, `groups` and `rate`.
Settings = Mapping[str, Any]


class StepRecorder:
    """Appends steps, and follows data between them; it knows tensors by id, so the caller keeps them alive."""

    def __init__(self, images: Tensor) -> None:
        self.steps: list[Step] = []
        self._behind: dict[int, frozenset[int]] = {id(images): frozenset()}

    def follow(
        self, op: str, inputs: Iterable[Tensor], results: Iterable[Tensor], *, weighted: bool, settings: Settings
    ) -> None:
        """Follow data from inputs to results, through a new step where the call is one."""
        given = list(inputs)[:1] if op in _LIKE else list(inputs)
        operands = [tensor for tensor in given if id(tensor) in self._behind]
        if not operands:
            return
        reached = list(results)
        behind = frozenset(self.behind(operands))
        name = activation(op) or (None if is_transparent(op) else op)
        if name is not None and len(self.steps) < MOST_STEPS:
            kept = operands[:MOST_OPERANDS]
            behind = frozenset({len(self.steps)})
            self.steps.append(
                Step(
                    op=name,
                    weighted=weighted,
                    sources=tuple(self.behind([tensor]) for tensor in kept),
                    operands=tuple(tuple(tensor.shape) for tensor in kept),
                    shape=tuple(reached[0].shape),
                    **settings,
                )
            )
        for result in reached:
            self._behind[id(result)] = behind

    def behind(self, tensors: Iterable[Tensor]) -> tuple[int, ...]:
        """Return the steps that tensors come from, rising; none for the image and for what does not depend on it."""
        return tuple(sorted(frozenset[int]().union(*(self._behind.get(id(tensor), ()) for tensor in tensors))))


def of_layer(op: str, layer: nn.Module) -> Settings:
    """Read the settings of a layer of torch.nn."""
    # Of other layers the weight is left alone: reading a parametrized one computes it, which the probe would count.
    tensors = [getattr(layer, "weight", None)] if op in CONVOLUTIONS else []
    return _settings(op, tensors, getattr(layer, "stride", 1), getattr(layer, "groups", 1), getattr(layer, "p", 0.0))


def of_call(op: str, args: tuple[Any, ...], kwargs: Mapping[str, Any], inputs: list[Tensor]) -> Settings:
    """Read the settings of a function."""

    def named(name: str, index: int, default: float) -> Any:
        return kwargs.get(name, args[index] if len(args) > index else default)

    return _settings(op, inputs, named("stride", _STRIDE, 1), named("groups", _GROUPS, 1), named("p", 1, _DROPOUT))


def _settings(op: str, tensors: Iterable[Any], stride: Any, groups: Any, rate: Any) -> Settings:
    """Write a call's settings in one form; a convolution's weight is the last tensor of its rank plus two dimensions.

    A probability that torch accepted is in [0, 1], as a number or, rarely, as a tensor.
    """
    rank = CONVOLUTIONS.get(op)
    if rank is None:
        is_known = "dropout" in op and isinstance(rate, int | float) and 0 <= rate <= 1
        return {"rate": float(rate)} if is_known else {}
    weights = [tensor for tensor in tensors if isinstance(tensor, Tensor) and tensor.dim() == rank + 2]
    return {
        "kernel": tuple(weights[-1].shape[2:]) if weights else (),
        "stride": _sides(stride, rank),
        "groups": groups if type(groups) is int and groups > 0 else 1,
    }


def _sides(value: Any, rank: int) -> tuple[int, ...]:
    """Write `2`, `(2,)` and `(2, 2)` alike; torch itself refuses what is neither a number nor as many as the rank."""
    sides = tuple(value) if isinstance(value, tuple | list) else (value,)
    sides = sides * rank if len(sides) == 1 else sides
    return sides if all(type(side) is int and side > 0 for side in sides) else ()
