"""The guards of a candidate's text: what it gets of Python, and what it may not reach or change in torch (child side).

The gate's policy reads names in the text. Here names are looked up that a text computes, or that it has a library look
up, set or run. `tests/support/candidates/doors.py` finds the places in the libraries that do so, and a test compares
them with what is guarded here. What this promises: no such place reaches a name that
`tacevo.sandbox.attributes` refuses, and a class of torch that was changed is seen. It is not the wall: that is the
process (`tacevo.sandbox.confinement`).
"""

import builtins
import copy
import dataclasses
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import FunctionType, ModuleType
from typing import Any

import torch
from torch import nn

from tacevo.records import Reason
from tacevo.sandbox.attributes import BUILTINS, MODES, MODULE_NAMES, MODULES, WEIGHTS, is_refused

#: Name of the module that a candidate's text becomes; its classes carry it.
NAME = "candidate"
_NAMES = """
    torch._tensor torch.nn.modules.container torch.nn.modules.module torch.nn.modules.rnn
    torch.nn.utils.parametrizations torch.nn.utils.parametrize torch.nn.utils.spectral_norm torch.nn.utils.weight_norm
"""
#: Modules that look up or set an attribute whose name, or owner, a text may give them.
LIBRARIES = tuple(_NAMES.split())
#: Refused names that these libraries look up themselves, each written out there.
_OF_LIBRARIES = frozenset({"__deepcopy__", "__func__", "__torch_function__", "__setstate__"})


class CandidateError(Exception):
    """The candidate failed: a verdict on its way up to the entry; the message is the detail."""

    def __init__(self, reason: Reason, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason


def _check_name(function: Callable[..., Any], owner: object, name: object, *, refused: bool) -> None:
    if type(name) is not str:  # a class of its own could answer for another name than it has
        raise TypeError(f"expected the name of an attribute as a string; got {type(name).__name__}")
    if refused:
        detail = f"{function.__name__} may not reach the attribute {name} of {type(owner).__name__}"
        raise CandidateError(Reason.forbidden_name, detail)


def _guarded(function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap `getattr` or its like, so that it refuses the names that the policy refuses."""
    writes = function in (setattr, delattr)

    def guarded(owner: Any, name: str, *rest: Any) -> Any:
        kinds = owner.__mro__ if isinstance(owner, type) else type(owner).__mro__
        is_own = any(kind.__module__ == NAME for kind in kinds)
        is_shared = isinstance(owner, type | ModuleType | FunctionType) and not is_own
        is_lacking = type(name) is str and (is_refused(name) or name in WEIGHTS + MODES)
        _check_name(function, owner, name, refused=is_lacking or (writes and (is_shared or name in MODULE_NAMES)))
        return function(owner, name, *rest)

    return guarded


def _guarded_inside(function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap the same for a library: it refuses what leads out of a network, and lets the library's own names pass."""

    def guarded(owner: Any, name: str, *rest: Any) -> Any:
        refused = type(name) is str and is_refused(name) and name not in _OF_LIBRARIES
        _check_name(function, owner, name, refused=refused)
        return function(owner, name, *rest)

    return guarded


def _import(
    name: str, globals: object = None, locals: object = None, fromlist: Sequence[str] | None = None, level: int = 0
) -> ModuleType | None:
    """Import what the policy lets a text import."""
    if type(fromlist) is list:  # C code below the text asks so, not an import statement, and takes no answer
        __import__(name)
        return None
    if level or name not in MODULES:
        raise CandidateError(Reason.forbidden_name, f"module {name} may not be imported in a network")
    return __import__(name, fromlist=fromlist or ())


_FUNCTIONS = (getattr, setattr, delattr, hasattr)

#: The built-in functions that a text gets.
TEXTS_BUILTINS: Mapping[str, Any] = {
    **{name: value for name, value in vars(builtins).items() if name not in BUILTINS},
    **{function.__name__: _guarded(function) for function in _FUNCTIONS},
    "__import__": _import,
}


def _close_doors() -> None:
    """Guard the places in libraries that look up, set or run a name which a text may give them."""
    for name in LIBRARIES:  # as modules: some of these names are also a function's
        for function in _FUNCTIONS:  # a module's own name comes before the built-in one
            setattr(sys.modules[name], function.__name__, _guarded_inside(function))
    copy.setattr = _guarded_inside(setattr)  # type: ignore[attr-defined]  # it sets what a class of a text reduces to
    make: Callable[..., type] = dataclasses._process_class  # type: ignore[attr-defined]
    if make.__module__ != __name__:  # where this module is imported again
        dataclasses._process_class = _checked_dataclass(make)  # type: ignore[attr-defined]


def _checked_dataclass(make: Callable[..., type]) -> Callable[..., type]:
    """Wrap what makes a dataclass: it writes the names of the fields into text, and runs that."""

    def checked(kind: type, *settings: Any, **more: Any) -> type:
        own = attributes_of_class(kind).get("__annotations__", {})
        bases = _CLASS_ORDER.__get__(kind)[1:]
        fields = [attributes_of_class(base).get("__dataclass_fields__", {}) for base in bases]
        # Of these exact types, so that nothing answers otherwise here than where the text is written.
        if any(type(each) is not dict for each in (own, *fields)):
            raise CandidateError(Reason.forbidden_name, "expected the fields of a dataclass in plain dictionaries")
        named = [part for each in fields for part in each.values()]
        for name in (*own, *(part.name if type(part) is dataclasses.Field else None for part in named)):
            if not (type(name) is str and name.isidentifier()):
                raise CandidateError(Reason.forbidden_name, "expected an identifier as the name of each field")
        return make(kind, *settings, **more)

    return checked


_close_doors()


def with_subclasses(kind: type) -> Iterator[type]:
    """Yield a class and all classes below it."""
    yield kind
    subclasses: list[type] = kind.__subclasses__()
    for below in subclasses:
        yield from with_subclasses(below)


# A metaclass may define its own `__dict__` and `__mro__`.
_CLASS_ATTRIBUTES, _CLASS_ORDER = vars(type)["__dict__"], vars(type)["__mro__"]


def attributes_of_class(kind: type) -> Mapping[str, Any]:
    """Return what one class itself defines."""
    own: Mapping[str, Any] = _CLASS_ATTRIBUTES.__get__(kind)
    return own


def _may_change(kind: type) -> bool:
    """Return whether a class takes new attributes, as those that are written in C do not (CPython's `tp_flags`)."""
    is_immutable, is_on_heap = kind.__flags__ & 1 << 8, kind.__flags__ & 1 << 9
    return bool(is_on_heap and not is_immutable)


def _snapshot(kinds: Iterable[type]) -> list[tuple[type, dict[str, Any], list[int]]]:
    """Return classes, each with its attributes and their ids; the attributes are kept, so that no id is used again."""
    copies = [(kind, dict(attributes_of_class(kind))) for kind in kinds if _may_change(kind)]
    return [(kind, own, [*map(id, own.values())]) for kind, own in copies]


#: Torch's own classes of modules, as they are before a candidate runs.
OF_TORCH = frozenset(with_subclasses(nn.Module))
#: Classes that a text may name, or is given by what it may name, and their own classes.
_NAMED = {value for path in MODULES for value in vars(sys.modules[path]).values() if isinstance(value, type)}
_NAMED |= {CandidateError, Reason, dataclasses.Field, *(base for kind in _NAMED for base in kind.__mro__)}
_NAMED |= {type(kind) for kind in _NAMED}
#: The classes whose methods a training calls.
_STEPS: list[type] = [torch.Tensor, nn.Parameter, type(nn.Parameter), nn.Module]
_STEPS += [torch.optim.Optimizer, torch.optim.Adam]
_MODES = [*torch.no_grad.__mro__, *torch.enable_grad.__mro__, *torch.set_grad_enabled.__mro__]
_USED = _snapshot([*_STEPS, *_MODES])
_EVERY = _USED + _snapshot(OF_TORCH | _NAMED)


def check_shared(*, every: bool = True) -> None:
    """Check that classes are as before the candidate ran: `every` one that a text may name, or those a training calls.

    A text may reach one by a variable (`T = torch.Tensor`), where the policy does not see what is assigned to.

    Raises:
        CandidateError: one was changed.
    """
    for kind, before, ids in _EVERY if every else _USED:
        own = attributes_of_class(kind)
        if [*map(id, own.values())] != ids:
            changed = {name for name in before.keys() | own.keys() if before.get(name, own) is not own.get(name, own)}
            # Python itself adds empty annotations to a class when they are first asked for.
            changed -= {"__annotations__"} - before.keys()
            if changed:
                detail = f"expected {kind.__module__}'s own {kind.__name__}.{min(changed)}; got another one"
                raise CandidateError(Reason.redefines_module, detail)
