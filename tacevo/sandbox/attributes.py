"""The names that a candidate's text may import and call, and the attributes that it may not reach (no torch).

The gate's policy reads the text by these lists. Where a text computes a name, or has a library look one up, the guards
of the candidate's process do (`tacevo.sandbox.guards`).
"""

import re

_MODULES = """
    torch torch.nn torch.nn.functional torch.nn.init torch.nn.parameter torch.nn.modules torch.nn.utils
    torch.nn.utils.parametrizations torch.linalg torch.fft torch.special torch.cuda
    math typing collections collections.abc functools itertools dataclasses enum abc copy __future__
"""
#: The modules that a text may import; the policy says which of their names it may use.
MODULES = frozenset(_MODULES.split())
_BUILTINS = "exec eval compile open globals locals vars __import__ breakpoint help exit quit memoryview"
#: Built-in functions that run text, reach files or show the interpreter's insides. No text gets them.
BUILTINS = frozenset(_BUILTINS.split())

#: Special methods that a candidate may define.
SPECIAL_METHODS = frozenset(
    ("__init__", "__len__", "__getitem__", "__iter__", "__next__", "__repr__", "__str__", "__post_init__")
)

#: Special names that it may assign in a class: TorchScript's list of constants does nothing here.
SPECIAL_BINDINGS = SPECIAL_METHODS | {"__constants__"}
#: Special methods that it may read, of `self` and of `super()`: of anything else one could be given another object.
READABLE_METHODS = SPECIAL_METHODS | {"__call__"}
#: Special names that it may read.
SPECIAL_NAMES = READABLE_METHODS | {"__class__", "__name__"}
#: Built-in functions that take the name of an attribute. A text may call them, but not pass them around.
ATTRIBUTE_FUNCTIONS = frozenset({"getattr", "setattr", "delattr", "hasattr"})
#: Attributes that change weights or modes. A text may use them in constructors, and never under a computed name.
WEIGHTS = ("data", "grad", "backward", "load_state_dict")
MODES = ("train", "eval")

_LEADING_OUT = """
    numpy ctypes tofile from_file storage untyped_storage data_ptr share_memory_ as_subclass mro _evaluate
    f_globals f_locals f_builtins f_back f_code tb_frame tb_next gi_frame gi_code cr_frame cr_code ag_frame ag_code
    _convert_ obj _version
"""

#: Private attributes of tensors and of the nodes of their graphs that reach memory, gradients or other constructors.
_PRIVATE = """
    _grad _grad_fn _cdata _typed_storage _make_subclass _make_wrapper_subclass _reduce_ex_internal _fix_weakref
    _view_func _view_func_unsafe _rev_view_func_unsafe _python_dispatch _lazy_clone _dtensor__new__ _register_hook_dict
"""

#: Names that register or hold hooks. Honest answers do not use them, and a hook could take an optimiser step with the
#: gradient that it is given.
_HOOK = re.compile(r"_?register_\w*hook|_\w*hooks(_\w+)?")

_MODULE_NAMES = """
    T_destination add_module apply buffers call_super_init children compile dump_patches eval get_buffer
    get_extra_state get_parameter get_submodule load_state_dict modules named_buffers named_children named_modules
    named_parameters parameters register_backward_hook register_buffer register_forward_hook register_forward_pre_hook
    register_full_backward_hook register_full_backward_pre_hook register_load_state_dict_post_hook
    register_load_state_dict_pre_hook register_module register_parameter register_state_dict_post_hook
    register_state_dict_pre_hook requires_grad_ set_extra_state set_submodule share_memory state_dict to to_empty
    train training zero_grad
    _apply _call_impl _compiled_call_impl _get_backward_hooks _get_backward_pre_hooks _get_name _load_from_state_dict
    _maybe_warn_non_full_backward_hook _named_members _register_load_state_dict_pre_hook _register_state_dict_hook
    _replicate_for_data_parallel _save_to_state_dict _slow_forward _version _wrapped_call_impl _backward_hooks
    _backward_pre_hooks _buffers _forward_hooks _forward_hooks_always_called _forward_hooks_with_kwargs
    _forward_pre_hooks _forward_pre_hooks_with_kwargs _is_full_backward_hook _load_state_dict_post_hooks
    _load_state_dict_pre_hooks _modules _non_persistent_buffers_set _parameters _state_dict_hooks
    _state_dict_pre_hooks
    __call__ __class__ __delattr__ __dir__ __getattr__ __getstate__ __setattr__ __setstate__
"""

#: The names that `nn.Module` and its objects define, and a candidate may not; it may define `__init__`, `forward` and
#: texts. The conversions are left out: nothing here calls them, and `self.half = 8` is honest.
MODULE_NAMES = frozenset(_MODULE_NAMES.split())

#: Private names of `nn.Module` that a text may read; the others run or change a module behind its back.
_READABLE = frozenset({"_modules", "_parameters", "_buffers", "_get_name"})

_REFUSED = frozenset(
    [*_LEADING_OUT.split(), *_PRIVATE.split(), *(name for name in MODULE_NAMES if name[0] == "_" and name[1] != "_")]
).difference(_READABLE)


#: Tensors that a node of a graph keeps, such as a layer's weight.
_SAVED = re.compile(r"_(raw_)?saved_\w+")


def is_special(name: str) -> bool:
    """Return whether a name is special to Python, e.g. `__init__`."""
    return name.startswith("__") and name.endswith("__")


def is_refused(attribute: str) -> bool:
    """Return whether an attribute leads out of the network, or hooks into it, whatever object it is of."""
    is_hidden = is_special(attribute) and attribute not in SPECIAL_NAMES
    return is_hidden or attribute in _REFUSED or any(form.fullmatch(attribute) for form in (_HOOK, _SAVED))
