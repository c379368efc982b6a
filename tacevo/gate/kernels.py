"""The record of a candidate's kernels: FLOPs, backward passes, bits that follow the CPU, random draws (child side).

What it promises: it sees every kernel that the probe's passes reach, called by a layer, a function, a method or
autograd, because it watches torch below all of them. What it does not promise: it does not see a branch that the
probe did not take, and the candidate shares this process, so all this is only its claim.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from math import prod
from typing import Any

import torch
from torch import Tensor
from torch.autograd.graph import Node
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import flop_registry

from tacevo.gate.operations import NOT_PORTABLE
from tacevo.sandbox.candidate import call_plainly

#: The number of values of a draw that are compared with those of another seed.
_COMPARED = 64
#: So many values are hardly ever equal under two seeds, even where each is 0 or 1.
_ENOUGH = 32


class KernelWatcher(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Sees each call of a kernel, after layers and compound functions have been taken apart."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        #: Names of the operations in `NOT_PORTABLE` that ran.
        self.not_portable: set[str] = set()
        #: Floating-point operations so far.
        self.flops = 0
        #: Kernels of backward passes so far, by their name, e.g. `convolution_backward`.
        self.backward: Counter[str] = Counter()
        #: Random draws so far, and those of them by a generator of the candidate's own.
        self.drawn = self.drawn_apart = 0
        self._draws: list[Tensor] | None = None

    @contextmanager
    def noting_draws(self) -> Iterator[list[Tensor]]:
        """Collect the first values of each random draw while the context lasts."""
        self._draws = []
        try:
            yield self._draws
        finally:
            self._draws = None

    def __torch_dispatch__(
        self, func: Any, types: Sequence[type], args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        kwargs = kwargs or {}
        if _is_compound(func):  # in inference mode torch has not taken it apart
            with self:
                return func.decompose(*args, **kwargs)
        name = _spelling(func, args)
        if name in NOT_PORTABLE:
            self.not_portable.add(name)
        if "_backward" in name:
            self.backward[name] += 1
        output = func(*args, **kwargs)
        formula = _FORMULAS.get(func._overloadpacket)
        if formula is not None:
            self.flops += formula(*args, **kwargs, out_val=output)
        if torch.Tag.nondeterministic_seeded in func.tags:
            self.drawn += 1
            self.drawn_apart += any(isinstance(part, torch.Generator) for part in (*args, *kwargs.values()))
            if self._draws is not None and isinstance(output, Tensor):
                self._draws.append(output.detach().reshape(-1)[:_COMPARED].clone())
        return output


call_plainly(KernelWatcher.__torch_dispatch__)


#: Nodes that run the kernel of another one, and those that run theirs once for each input that learns.
_RUNS = {"celubackward": "elubackward", "relubackward": "thresholdbackward"}
_PER_INPUT = frozenset({"cdistbackward", "mselossbackward", "smoothl1lossbackward", "huberlossbackward"})


def too_often(kernels: Counter[str], nodes: Iterable[Node]) -> str | None:
    """Return the name of a kernel that ran more often than one backward pass runs it: once for each node of its name.

    None where there is none. Kernels that no node of the graph is named after are not compared.
    """
    # A node is named `AdaptiveAvgPool2DBackward0`, its kernel `_adaptive_avg_pool2d_backward`.
    often: Counter[str] = Counter()
    for node in nodes:
        name = node.name().rstrip("0123456789").lower()
        learning = sum(following is not None for following, _ in node.next_functions)
        often[_RUNS.get(name, name)] += learning if name in _PER_INPUT else 1
    names = ((name, name.replace("_", "")) for name in sorted(kernels))
    return next((name for name, node in names if node in often and kernels[name] > often[node]), None)


def follow_the_seed(draws: Sequence[Tensor], others: Sequence[Tensor]) -> bool:
    """Return whether the draws of a construction differ from those under another seed, one by one.

    What only one of the two drew, because a network branches by what it drew, follows the seed.
    """
    return not any(_tells(draw) and torch.equal(draw, other) for draw, other in zip(draws, others, strict=False))


def _tells(draw: Tensor) -> bool:
    """Return whether chance, or a range of one value, hardly makes a draw equal under two seeds."""
    if draw.numel() > 1 and bool((draw == draw[0]).all()):
        return False
    return draw.numel() >= _ENOUGH or bool((draw != draw.round()).any() if draw.is_floating_point() else False)


@cache
def _is_compound(func: Any) -> bool:
    return bool(func._can_decompose())


def _spelling(func: Callable[..., Any], args: tuple[Any, ...]) -> str:
    """Return a kernel's name as in `NOT_PORTABLE`: a power of 0.5 is a square root, and `out=` is named with it."""
    _, name, overload = str(func).split(".")
    is_root = name in ("pow", "pow_") and len(args) > 1 and isinstance(args[1], float) and args[1] == 0.5
    plain = "sqrt" if is_root else name.rstrip("_")
    return f"{plain}_out" if overload.endswith("out") else plain


def _recurrent(inputs: Tensor, input_weight: Tensor, hidden_weight: Tensor, *_: Any, **__: Any) -> int:
    """Count one layer of an LSTM in one direction: at each step all gates, as an nn.GRU is counted.

    Inputs are of shape (steps, N, features).
    """
    return 2 * prod(inputs.shape[:2]) * (input_weight.numel() + hidden_weight.numel())


def _product(*operands: Any, **_: Any) -> int:
    """Count a product of a matrix, the first operand, and a vector, or of two vectors."""
    return 2 * int(operands[0].numel())


def _added(_: Tensor, *operands: Any, **__: Any) -> int:
    """Count a product that is added to a tensor: of a matrix and a vector, or of batches of matrices."""
    first, second = operands[:2]
    return 2 * int(first.numel()) * int(second.shape[-1] if second.dim() > 1 else 1)


def _distances(first: Tensor, second: Tensor, *_: Any, **__: Any) -> int:
    """Count the distances of all pairs of rows."""
    return 2 * first.numel() * second.shape[-2]


def _trilinear(first: Tensor, weight: Tensor, second: Tensor, *unsqueezed: Any, **_: Any) -> int:
    """Count what nn.Bilinear calls: one product and one sum for each pair of features, output and row."""
    expanded = [first, weight, second]
    for index, dimensions in enumerate(unsqueezed[:3]):
        for dimension in dimensions:
            expanded[index] = expanded[index].unsqueeze(dimension)
    full: torch.Size = torch.broadcast_tensors(*expanded)[0].shape  # type: ignore[no-untyped-call]
    return 2 * full.numel()


_aten = torch.ops.aten

#: The functions that count the FLOPs of kernels, by their names: torch's own formulas, and those of products that torch
#: counts as 0.
_FORMULAS: Mapping[Any, Callable[..., int]] = {
    **flop_registry,
    _aten.mkldnn_rnn_layer: _recurrent,
    _aten.mkldnn_rnn_layer_backward: lambda *args, **_: 2 * _recurrent(*args),
    _aten._scaled_dot_product_flash_attention_for_cpu: flop_registry[_aten._scaled_dot_product_flash_attention],
    _aten._scaled_dot_product_flash_attention_for_cpu_backward: flop_registry[
        _aten._scaled_dot_product_flash_attention_backward
    ],
    **dict.fromkeys((_aten.mv, _aten.dot, _aten.vdot), _product),
    **dict.fromkeys((_aten.addmv, _aten.addbmm), _added),
    **dict.fromkeys((_aten._cdist_forward, _aten._euclidean_dist), _distances),
    _aten._trilinear: _trilinear,
}
