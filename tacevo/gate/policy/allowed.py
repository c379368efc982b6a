"""What a candidate's text may name: an allow-list of modules and of the names in each.

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
        "typing": _CLASS + "|cast|overload",
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

#: What may be imported, as a message lists it.
IMPORTABLE = ", ".join(sorted({name.split(".")[0] for name in _MODULES} - {"__future__"}))

_BUILTINS = "exec eval compile open globals locals vars __import__ breakpoint help exit quit memoryview"

_SPECIAL_METHODS = "__init__ __len__ __getitem__ __iter__ __next__ __repr__ __str__ __post_init__"

#: Built-in functions that run text, reach files or show the interpreter's insides.
BUILTINS = frozenset(_BUILTINS.split())

#: Built-in functions whose results follow memory addresses; a text may use the names for its own variables.
UNSTABLE = frozenset({"set", "frozenset", "id"})

#: Built-in functions that may be called by name but never passed around.
CALLED_ONLY = frozenset({"getattr", "setattr", "delattr", "hasattr"})

_ATTRIBUTES = """
    numpy ctypes tofile from_file storage untyped_storage data_ptr share_memory_ as_subclass mro
    f_globals f_locals f_builtins f_back f_code tb_frame tb_next gi_frame gi_code cr_frame cr_code ag_frame ag_code
"""

#: Names that register or hold hooks. Honest answers do not use them, and a hook could take an optimiser step with the
#: gradient that it is given.
_HOOK = re.compile(r"_?register_\w*hook|_\w*hooks(_\w+)?")

_MODULE_NAMES = """
    T_destination add_module apply bfloat16 buffers call_super_init children compile cpu cuda double dump_patches eval
    float get_buffer get_extra_state get_parameter get_submodule half ipu load_state_dict modules mtia named_buffers
    named_children named_modules named_parameters parameters register_backward_hook register_buffer
    register_forward_hook register_forward_pre_hook register_full_backward_hook register_full_backward_pre_hook
    register_load_state_dict_post_hook register_load_state_dict_pre_hook register_module register_parameter
    register_state_dict_post_hook register_state_dict_pre_hook requires_grad_ set_extra_state set_submodule
    share_memory state_dict to to_empty train training type xpu zero_grad
    _apply _call_impl _compiled_call_impl _get_backward_hooks _get_backward_pre_hooks _get_name _load_from_state_dict
    _maybe_warn_non_full_backward_hook _named_members _register_load_state_dict_pre_hook _register_state_dict_hook
    _replicate_for_data_parallel _save_to_state_dict _slow_forward _version _wrapped_call_impl
    _backward_hooks _backward_pre_hooks _buffers _forward_hooks _forward_hooks_always_called
    _forward_hooks_with_kwargs _forward_pre_hooks _forward_pre_hooks_with_kwargs _is_full_backward_hook
    _load_state_dict_post_hooks _load_state_dict_pre_hooks _modules _non_persistent_buffers_set _parameters
    _state_dict_hooks _state_dict_pre_hooks
    __call__ __class__ __delattr__ __dir__ __getattr__ __getstate__ __setattr__ __setstate__
"""

_REFUSED = frozenset(_ATTRIBUTES.split())

#: Special methods that a candidate may define.
SPECIAL_METHODS = frozenset(_SPECIAL_METHODS.split())

#: What `nn.Module` and its objects define, and a candidate may not; it may define `__init__`, `forward` and texts.
MODULE_NAMES = frozenset(_MODULE_NAMES.split())

#: Special names that it may assign in a class: TorchScript's list of constants does nothing here.
SPECIAL_BINDINGS = SPECIAL_METHODS | {"__constants__"}

#: Special names that it may read.
SPECIAL_NAMES = SPECIAL_METHODS | {"__call__", "__class__", "__name__"}


def is_refused(attribute: str) -> bool:
    """Return whether an attribute of a tensor, module, frame or function leads out of the network or hooks into it."""
    return attribute in _REFUSED or _HOOK.fullmatch(attribute) is not None


def is_module(path: str) -> bool:
    """Return whether a dotted path is a module that may be named."""
    return path in _MODULES


def is_allowed(module: str, name: str) -> bool:
    """Return whether a name of an allowed module may be used."""
    return _MODULES[module].fullmatch(name) is not None
