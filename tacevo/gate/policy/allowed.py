"""The names that a candidate's text may use: an allow-list of modules and of the names in each.

It allows most of mathematics and all layers, but not files, processes, code generation, threads, seeds and global
switches. A new layer of `torch.nn` needs no entry, because layers are allowed by the form of their names.
"""

import re
from collections.abc import Mapping

#: Names that a candidate may use without importing them, as the sandbox provides them.
PROVIDED: Mapping[str, str] = {"torch": "torch", "nn": "torch.nn", "F": "torch.nn.functional", "math": "math"}
_CLASS = r"[A-Z]\w*"
_FUNCTION = r"[a-z]\w*"  # for modules written in C, which import no others

_TORCH = """
    Tensor Size Generator device dtype memory_format layout finfo iinfo is_tensor is_floating_point is_complex
    is_grad_enabled no_grad enable_grad inference_mode
    float float16 float32 float64 half double bfloat16 int int8 int16 int32 int64 uint8 long short bool
    cfloat complex64 complex128 channels_last contiguous_format preserve_format strided pi e inf nan
    tensor as_tensor scalar_tensor zeros zeros_like ones ones_like full full_like empty empty_like eye arange linspace
    logspace rand rand_like randn randn_like randint randperm normal bernoulli meshgrid cartesian_prod combinations
    tril triu tril_indices triu_indices diag diag_embed diagonal hann_window hamming_window complex polar vander
    abs absolute acos arccos acosh add addbmm addcdiv addcmul addmm addmv addr all allclose amax amin aminmax angle any
    argmax argmin argsort asin arcsin asinh atan arctan atan2 atanh atleast_1d atleast_2d atleast_3d baddbmm bmm
    broadcast_tensors broadcast_to bucketize cat cdist ceil chain_matmul channel_shuffle chunk clamp clamp_max
    clamp_min clip clone column_stack concat concatenate conj copysign cos cosh cosine_similarity count_nonzero cov
    cross cummax cummin cumprod cumsum deg2rad det detach diff digamma dist div divide dot dsplit dstack einsum eq
    equal erf erfc erfinv exp exp2 expm1 fill flatten flip fliplr flipud float_power floor floor_divide fmax fmin fmod
    frac gather ge gradient greater greater_equal gt heaviside histc hsplit hstack hypot imag index_add index_copy
    index_fill index_select inner inverse isclose isfinite isin isinf isnan kron kthvalue ldexp le lerp less
    less_equal lgamma log log10 log1p log2 logaddexp logaddexp2 logcumsumexp logdet logical_and logical_not
    logical_or logical_xor logit logsumexp lt masked_fill masked_scatter masked_select matmul matrix_exp matrix_power
    max maximum mean median min minimum mm mode moveaxis movedim msort mul multinomial multiply mv nan_to_num nanmean
    nanmedian nansum narrow ne neg negative nonzero norm not_equal numel outer pairwise_distance permute pixel_shuffle
    pixel_unshuffle positive pow prod quantile rad2deg ravel real reciprocal remainder renorm repeat_interleave
    reshape result_type roll rot90 round rsqrt rsub scatter scatter_add scatter_reduce searchsorted select sgn sigmoid
    sign sin sinc sinh slogdet softmax log_softmax sort split sqrt square squeeze stack std std_mean stft istft sub
    subtract sum swapaxes swapdims t take take_along_dim tan tanh tensor_split tensordot threshold tile topk trace
    transpose trapezoid true_divide trunc unbind unflatten unique unsqueeze var var_mean vdot view_as_complex
    view_as_real vsplit vstack where xlogy block_diag
    relu relu_ rrelu selu celu prelu hardshrink dropout alpha_dropout feature_dropout bilinear embedding
    conv1d conv2d conv3d conv_transpose1d conv_transpose2d conv_transpose3d avg_pool1d max_pool1d max_pool2d max_pool3d
    adaptive_avg_pool1d adaptive_max_pool1d batch_norm layer_norm group_norm instance_norm rms_norm
"""

_FUNCTIONAL = """
    conv1d conv2d conv3d conv_transpose1d conv_transpose2d conv_transpose3d unfold fold linear bilinear
    avg_pool1d avg_pool2d avg_pool3d max_pool1d max_pool2d max_pool3d max_unpool1d max_unpool2d max_unpool3d
    lp_pool1d lp_pool2d lp_pool3d fractional_max_pool2d fractional_max_pool3d
    adaptive_avg_pool1d adaptive_avg_pool2d adaptive_avg_pool3d
    adaptive_max_pool1d adaptive_max_pool2d adaptive_max_pool3d
    scaled_dot_product_attention multi_head_attention_forward
    threshold relu relu_ relu6 hardtanh hardtanh_ hardswish elu elu_ selu selu_ celu celu_ leaky_relu leaky_relu_ prelu
    rrelu rrelu_ glu gelu logsigmoid hardshrink softshrink tanhshrink softsign softplus softmin softmax gumbel_softmax
    log_softmax tanh sigmoid hardsigmoid silu mish
    batch_norm group_norm instance_norm layer_norm local_response_norm rms_norm normalize
    dropout dropout1d dropout2d dropout3d alpha_dropout feature_alpha_dropout embedding one_hot
    pairwise_distance cosine_similarity pdist pad interpolate upsample upsample_nearest upsample_bilinear
    grid_sample affine_grid pixel_shuffle pixel_unshuffle channel_shuffle
    mse_loss l1_loss smooth_l1_loss huber_loss cross_entropy nll_loss kl_div binary_cross_entropy
    binary_cross_entropy_with_logits
"""

_LINALG = """
    norm vector_norm matrix_norm svd svdvals qr inv pinv det slogdet eigh eigvalsh cholesky solve lstsq matmul vecdot
    multi_dot cross matrix_exp matrix_power
"""

_SPECIAL = (
    "expit logit erf erfc erfinv softmax log_softmax logsumexp gammaln digamma xlogy entr ndtr sinc log1p expm1 exp2"
)


#: The names of `typing` that are allowed. `ForwardRef` is not: it runs the text that it is given.
_TYPING = """
    Annotated Any Callable ClassVar Collection Concatenate Container Counter DefaultDict Deque Dict Final FrozenSet
    Generator Generic Hashable Iterable Iterator List Literal Mapping MutableMapping MutableSequence NamedTuple Never
    NewType NoReturn Optional OrderedDict ParamSpec Protocol Reversible Self Sequence Set Sized SupportsFloat
    SupportsInt TYPE_CHECKING Text Tuple Type TypeAlias TypeGuard TypeVar TypeVarTuple TypedDict Union Unpack
    cast final overload override runtime_checkable
"""


def _one_of(names: str) -> str:
    return "|".join(names.split())


#: Every module that may be named, with the pattern of the names in it that are allowed.
_MODULES: Mapping[str, re.Pattern[str]] = {
    module: re.compile(pattern)
    for module, pattern in {
        "torch": _one_of(_TORCH),
        "torch.nn": r"(?!Lazy|DataParallel)" + _CLASS,
        "torch.nn.functional": _one_of(_FUNCTIONAL),
        "torch.nn.init": r"calculate_gain|[a-z]\w*_",
        "torch.nn.parameter": "Parameter|Buffer",
        "torch.nn.modules": r"(?!Lazy|DataParallel)" + _CLASS,
        "torch.nn.utils": "spectral_norm|weight_norm|skip_init|parameters_to_vector",
        "torch.nn.utils.parametrizations": "spectral_norm|weight_norm|orthogonal",
        "torch.linalg": _one_of(_LINALG),
        "torch.fft": r"(ir|i|r|h|ih)?fft[2n]?|r?fftfreq|i?fftshift",
        "torch.special": _one_of(_SPECIAL),
        "torch.cuda": "is_available",
        "math": _FUNCTION,
        "typing": _one_of(_TYPING),
        "collections": "OrderedDict|defaultdict|deque|namedtuple|Counter",
        "collections.abc": _CLASS,
        "functools": "partial|reduce|lru_cache|cache|wraps|cached_property",
        "itertools": _FUNCTION,
        "dataclasses": "dataclass|field",
        "enum": "Enum|IntEnum|StrEnum|auto",
        "abc": "ABC|abstractmethod",
        "copy": "copy|deepcopy",
        "__future__": "annotations",
    }.items()
}

#: The modules that may be imported, as a message lists them.
IMPORTABLE = ", ".join(sorted({name.split(".")[0] for name in _MODULES} - {"__future__"}))
#: Built-in functions whose results follow memory addresses; a text may use the names for its own variables.
UNSTABLE = frozenset({"set", "frozenset", "id"})


def is_module(path: str) -> bool:
    """Return whether a dotted path is a module that may be named."""
    return path in _MODULES


def is_allowed(module: str, name: str) -> bool:
    """Return whether a name of an allowed module may be used."""
    return _MODULES[module].fullmatch(name) is not None
