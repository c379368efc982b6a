"""The names of traced calls, and which calls are operations (see docs/descriptors.md).

A layer and its function, a method and its in-place form, an operator and its reflection get one name, so that the same
network has the same graph however it is written. This module knows names only, not tensors.
"""

import re
from collections.abc import Mapping

#: Calls that move or relabel values: data flows through them, but they are not operations.
_SHAPING = """
    flatten unflatten ravel view view_as reshape reshape_as permute transpose t swapaxes swapdims movedim moveaxis
    squeeze unsqueeze contiguous getitem setitem get chunk split tensor_split hsplit vsplit unbind narrow select
    expand expand_as broadcast_to broadcast_tensors repeat tile atleast_1d atleast_2d atleast_3d
    to type type_as float double half bfloat16 cpu clone detach copy alias requires_grad identity sequential
"""

#: Simple element-wise activations, which the paper leaves out of its operation types.
_ACTIVATIONS = """
    relu relu6 leaky_relu prelu rrelu elu selu celu gelu silu mish sigmoid log_sigmoid hardsigmoid hardswish tanh
    hardtanh hardshrink softshrink tanhshrink softplus softsign threshold
"""

#: Calls that take only shape and type from their tensor; what they return does not depend on its values.
_FACTORIES = """
    zeros_like ones_like full_like empty_like rand_like randn_like randint_like
    new_zeros new_ones new_full new_empty new_tensor
"""

#: Convolutions, each with the number of image dimensions of its kernel.
CONVOLUTIONS = {f"conv{form}{rank}d": rank for form in ("", "_transpose") for rank in (1, 2, 3)}

_WEIGHTED = """
    linear bilinear matmul einsum tensordot addmm baddbmm multihead_attention rnn lstm gru rnn_cell lstm_cell gru_cell
"""

#: Operations that can have a weight of two or more dimensions; normalisations only scale, so they are not included.
WEIGHTED = CONVOLUTIONS.keys() | _WEIGHTED.split()

#: Kernels of torch whose last bit depends on the CPU even under portable numerics, with what calls them, as
#: measured (docs/determinism.md): there MKL and oneDNN choose their code by the CPU under every setting.
NOT_PORTABLE: Mapping[str, str] = {
    "sqrt_out": "torch.sqrt and pow with exponent 0.5, with `out=`; without, tacevo.sandbox.functions computes them",
    "atan_out": "torch.atan and torch.arctan with `out=`",
    "acos_out": "torch.acos and torch.arccos with `out=`",
    "asin_out": "torch.asin and torch.arcsin with `out=`",
    "tan_out": "torch.tan of float64 with `out=`",
    "linalg_cholesky_ex": "torch.linalg.cholesky",
    "mkldnn_rnn_layer": "nn.LSTM",
}

_SYNONYMS = {
    **{f"{form}{op}": op for op in ("add", "sub", "mul", "div", "pow", "matmul") for form in ("i", "r")},
    **{"truediv": "div", "itruediv": "div", "rtruediv": "div", "true_divide": "div", "divide": "div"},
    **{"subtract": "sub", "multiply": "mul", "negative": "neg", "absolute": "abs", "clip": "clamp"},
    **{"concat": "cat", "concatenate": "cat", "mm": "matmul", "bmm": "matmul", "linalg_matmul": "matmul"},
    **{f"{kind}_pad_nd": "pad" for kind in ("constant", "reflection", "replication", "circular")},
    **{"lppool1d": "lp_pool1d", "lppool2d": "lp_pool2d", "lppool3d": "lp_pool3d", "rmsnorm": "rms_norm"},
    **{"upsample": "interpolate", "softmax2d": "softmax", "multi_head_attention_forward": "multihead_attention"},
}

_WORD_START = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")


def operation(name: str) -> str:
    """Return one name for all forms of an operation, e.g. `max_pool2d` for `MaxPool2d`, `add` for `__iadd__`.

    A form is the name of the class that defines a layer's `forward`, of a torch function or of a tensor method.
    """
    snake = _WORD_START.sub("_", name.strip("_")).lower().removesuffix("_with_indices")
    return _SYNONYMS.get(snake, snake)


def _squashed(name: str) -> str:
    """Drop the underscores, because `LeakyReLU` does not show where the words of `leaky_relu` begin."""
    return name.replace("_", "")


_TRANSPARENT = frozenset(map(_squashed, (_SHAPING + _ACTIVATIONS).split()))
#: torch derives its layer ReLU6 from Hardtanh, whose forward pass it inherits; so the function is called that, too.
_ACTIVATION_NAMES = {_squashed(name): name for name in _ACTIVATIONS.split()} | {"relu6": "hardtanh"}
_SHAPE_ONLY = frozenset(map(_squashed, _FACTORIES.split()))


def is_transparent(op: str) -> bool:
    """Return whether data passes through this call without a node."""
    return _squashed(op) in _TRANSPARENT


def activation(op: str) -> str | None:
    """Return the name of a simple activation, e.g. `leaky_relu` for the layer's `leaky_re_lu`; None for others."""
    return _ACTIVATION_NAMES.get(_squashed(op))


def is_factory(op: str) -> bool:
    """Return whether this call reads no value of the tensor that it is given."""
    return _squashed(op) in _SHAPE_ONLY
