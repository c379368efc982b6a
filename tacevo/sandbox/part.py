"""The process of a part that decides: it runs one method of it, once, and ends.

Everything that a part may import is imported here, before the process is confined; what it imports beside that must be
among its recorded sources.
"""

import builtins
import contextlib
import dataclasses
import importlib
import math
import operator
import os
import random
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import BuiltinImporter, FrozenImporter, ModuleSpec
from types import ModuleType
from typing import Any

import numpy as np

from tacevo.parts import protocols
from tacevo.parts.protocols import ALLOWED, is_allowed
from tacevo.profile import Graph, Node, Profile, Step
from tacevo.records import Json
from tacevo.sandbox.child import Arrays, Send
from tacevo.sandbox.protocol import Header
from tacevo.text import listed, nearest

#: The modules that NumPy and Python import when they are first needed, which a confined process could not.
_LATE = ("ma", "fft", "polynomial", "typing", "char", "rec", "strings", "random", "linalg")

for _module in [*sorted(ALLOWED), *(f"numpy.{name}" for name in _LATE), "unicodedata", "numpy.lib.stride_tricks"]:
    with contextlib.suppress(ImportError):  # not every NumPy has all of them
        importlib.import_module(_module)

#: The types of settings.
TYPES: Mapping[str, type] = {"int": int, "float": float, "bool": bool, "str": str}

#: The method whose answer is sent as numbers, and not as JSON: it may be long.
CENTROIDS = "archives.centroids"

#: The sizes of the small objects of Python, in bytes, above those of an object and a float, and how many of each are
#: made and freed again, so that others lie where they were.
_SIZES, _OF_EACH = range(48, 513, 16), 500

#: The objects among them that are kept.
_KEPT: list[object] = []

#: The difference, in seconds, between the clocks of two processes that make one decision.
_LATER = 1_000_003


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class SeenCandidate:
    """A `tacevo.parts.Candidate`."""

    id: str
    source: str
    fitness: float
    losses: tuple[float, ...]
    parameters: int
    flops: int
    parents: tuple[str, ...]
    curiosity: float


class _Recorded(MetaPathFinder, Loader):
    """Imports the modules of a part from their recorded texts."""

    def __init__(self, sources: Mapping[str, str]) -> None:
        self._sources = sources

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Find a module among the texts."""
        folder = name.replace(".", "/")
        for file in (f"{folder}/__init__.py", f"{folder}.py"):
            if file in self._sources:
                return ModuleSpec(name, self, origin=file, is_package=file.endswith("/__init__.py"))
        if any(file.startswith(f"{folder}/") for file in self._sources):
            return ModuleSpec(name, None, is_package=True)  # a namespace, which has no file of its own
        return None

    def _import(self, name: str, *arguments: Any, **named: Any) -> ModuleType:
        """Import what a part may: its own modules, and those of `ALLOWED`, whatever else this process has."""
        level = arguments[3] if len(arguments) > 3 else named.get("level", 0)
        wanted = [f"{name}.{each}" for each in (arguments[2] if len(arguments) > 2 else named.get("fromlist")) or ()]
        known = is_allowed(name) or (bool(wanted) and all(map(is_allowed, wanted)))
        if level == 0 and not (known or self.find_spec(name) is not None):
            raise ImportError(f"a part that decides may not import {name}")
        return __import__(name, *arguments, **named)

    def create_module(self, spec: ModuleSpec) -> None:
        """Let Python make the module."""

    def exec_module(self, module: ModuleType) -> None:
        """Run its text."""
        file = str(module.__spec__.origin)  # type: ignore[union-attr]
        module.__dict__["__builtins__"] = {**vars(builtins), "__import__": self._import}
        exec(compile(self._sources[file], file, "exec"), module.__dict__)


def decide(header: Header, payload: bytes, arrays: Arrays, send: Send) -> object:
    """Make one decision, and send it as one frame, `{"answer": ...}`, or `{"fault": ...}` where the part is at fault.

    The header has `sources`, `module`, `attribute` and `base` of the part, its `settings`, the `method`, what is
    `given` to it, and the number of the `process`, 0 or 1: two processes differ in their clocks, in what they say of
    the machine, and in where objects lie and in which order, which no decision may follow from. A draw that `rng` does
    not make raises. Centroids are sent as float64 behind the header, which then has their `columns`.
    """
    number = header["process"]
    _refuse_global_generators()
    _change_surroundings(number)
    for name in ("time", "monotonic", "perf_counter", "process_time"):
        setattr(time, name, _shifted(getattr(time, name), number * _LATER))
        setattr(time, f"{name}_ns", _shifted(getattr(time, f"{name}_ns"), number * _LATER * 10**9))
    _place_objects(number)
    sys.meta_path[:] = [_Recorded(header["sources"]), BuiltinImporter, FrozenImporter]
    payload = b""
    try:
        answer: dict[str, Json] = {"answer": _answer(header)}
        if header["method"] == CENTROIDS:
            points = np.array(answer["answer"], np.float64)  # raises where points have unequal lengths
            answer, payload = {"columns": points.shape[-1]}, points.tobytes()
    except Exception as error:
        answer = {"fault": _told(error, header["sources"])}
    send(answer, payload)
    return None


def _refuse_global_generators() -> None:
    """Let draws from the generators of `random` and `numpy.random`, and unseeded ones, raise."""
    for module, generator in ((random, random._inst), (np.random, np.random.mtrand._rand)):
        for name in dir(module):
            if getattr(getattr(module, name), "__self__", None) is generator:
                setattr(module, name, _refusing(f"{module.__name__}.{name}"))
    seeded = np.random.default_rng

    def default_rng(seed: Any = None) -> np.random.Generator:
        return _refusing("numpy.random.default_rng without a seed")() if seed is None else seeded(seed)

    np.random.default_rng = default_rng


def _refusing(name: str) -> Callable[..., Any]:
    def refuse(*_: object, **__: object) -> Any:
        raise RuntimeError(f"{name} draws what no record has; draw from `rng` alone")

    return refuse


def _change_surroundings(number: int) -> None:
    """Let each process say something else of the machine and of its start, which a part may have found a way to."""
    sys.argv[:] = [str(number)]
    sys.orig_argv[:] = sys.argv
    sys.path[:] = [f"/{number}"]
    sys.executable = sys.prefix = sys.exec_prefix = f"/{number}"
    os.environ.clear()
    os.environ["PROCESS"] = str(number)
    for name, value in {"cpu_count": 1 + number, "getppid": 1 + number, "getcwd": f"/{number}"}.items():
        setattr(os, name, partial(_first_of, value))
    os.sched_getaffinity = partial(_first_of, set(range(1 + number)))
    os.uname = partial(_first_of, os.uname_result((f"{number}",) * 5))


def _first_of(value: Any, *_: object) -> Any:
    return value


def _place_objects(number: int) -> None:
    """Let small objects that are made from now on lie at rising addresses, or in the second process at falling ones.

    Python gives the place that was freed last first. Larger ones lie elsewhere in the second process.
    """
    made: list[object] = [object() for _ in range(_OF_EACH)]
    made += [float(each) for each in range(_OF_EACH)]
    made += [bytes(size - sys.getsizeof(b"")) for size in _SIZES for _ in range(_OF_EACH)]
    made.sort(key=id, reverse=number == 1)
    _KEPT.extend(made[::2])
    freed = made[1::2]
    del made
    while freed:
        freed.pop()
    _KEPT.extend(bytes(number << power) for power in range(10, 20))


def _shifted(clock: Callable[[], Any], by: int) -> Callable[[], Any]:
    return lambda: clock() + by


def _told(error: Exception, sources: Mapping[str, str]) -> str:
    """Say what a part raised, and in which line of it."""
    place, trace = "", error.__traceback__
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if file in sources:
            place = f", {file}, line {trace.tb_lineno}"
        trace = trace.tb_next
    if isinstance(error, SyntaxError) and error.filename in sources:
        place = f", {error.filename}, line {error.lineno}"
    return f"{type(error).__name__}: {error}{place}"


def _class(header: Header) -> type:
    """Import the class of a part.

    Raises:
        AttributeError: its module has no such name.
        TypeError: it is none of its kind, or no frozen dataclass.
    """
    module, name = __import__(header["module"], fromlist=[header["attribute"]]), header["attribute"]
    if not hasattr(module, name):
        own = [key for key, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__]
        raise AttributeError(f"no {name} in it; {nearest(name, own, f'it has {listed(own)}')}")
    made = getattr(module, name)
    base: type = getattr(protocols, header["base"])
    if not (isinstance(made, type) and issubclass(made, base)):
        raise TypeError(f"expected a class that extends tacevo.parts.{base.__name__}; got {made!r}")
    if not (dataclasses.is_dataclass(made) and made.__dataclass_params__.frozen):  # type: ignore[attr-defined]
        raise TypeError(f"expected {made.__name__} to be a dataclass(frozen=True); got one that can change")
    return made


def _describe(made: type[Any], constants: Sequence[str]) -> Json:
    """Return the settings of a part with their types and defaults, and the constants of its class."""
    fields: dict[str, Json] = {}
    for field in dataclasses.fields(made):
        if field.name in constants:
            raise TypeError(f"expected settings beside {field.name}, which is a constant of the class: use ClassVar")
        if not field.init:
            continue
        kind = field.type if isinstance(field.type, str) else getattr(field.type, "__name__", str(field.type))
        if kind not in TYPES:
            raise TypeError(f"expected a setting {field.name} of type {', '.join(TYPES)}; got {kind}")
        default = field.default
        if field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        if default is dataclasses.MISSING:
            default = None
        elif type(default).__name__ != kind and not (kind == "float" and type(default) is int):
            raise TypeError(f"expected a default of {field.name} that is {kind}; got {default!r}")
        fields[field.name] = {"type": kind, "default": default}
    values = {name: getattr(made, name) for name in constants}
    for name, value in values.items():
        if type(value) is not bool:
            raise TypeError(f"expected {name}, a constant of the class, to be True or False; got {value!r}")
    return {"fields": fields, "constants": values}


def _generator(key: Any) -> np.random.Generator:
    """Return a fresh generator of a key, two integers, as `tacevo.randomness.stream` makes it."""
    return np.random.Generator(np.random.Philox(key=np.array(key, np.uint64)))


def _candidates(given: Any) -> list[SeenCandidate]:
    return [SeenCandidate(**{**one, "losses": tuple(one["losses"]), "parents": tuple(one["parents"])}) for one in given]


def _pool(given: Any) -> tuple[Any, ...]:
    candidates = {one.id: one for one in _candidates(given["candidates"])}
    elites = [candidates[name] for name in given["elites"]]
    return (protocols.Population(generation=given["generation"], candidates=candidates, elites=elites),)


def _draw_parents(given: Any) -> tuple[Any, ...]:
    return _candidates(given["pool"]), given["number"], _generator(given["rng"])


def _ids(chosen: Any) -> list[str]:
    return [one.id if isinstance(one, SeenCandidate) else repr(one)[:100] for one in chosen]


def _draw_prompt(given: Any) -> tuple[Any, ...]:
    history = protocols.PromptHistory(
        trials=[protocols.Trial(**trial) for trial in given["trials"]],
        changes={int(prompt): (count, total) for prompt, (count, total) in given["changes"].items()},
    )
    return history, tuple(given["pool"]), _generator(given["rng"])


def _next(given: Any) -> tuple[Any, ...]:
    return (protocols.Generation(**given["ended"]),)


def _of(given: Any) -> tuple[Any, ...]:
    return (tuple(given["losses"]),)


def _describe_network(given: Any) -> tuple[Any, ...]:
    return (_profile(given["profile"]),)


def _profile(value: Any) -> Profile:
    """Read a profile, which was checked where it came from a candidate; here there is no pydantic."""
    value = _frozen(value)
    nodes = tuple(Node(**node) for node in value["graph"]["nodes"])
    steps = tuple(Step(**step) for step in value["steps"])
    return Profile(**{**value, "graph": Graph(**{**value["graph"], "nodes": nodes}), "steps": steps})


def _frozen(value: Any) -> Any:
    """Return JSON with tuples in place of its lists."""
    if isinstance(value, dict):
        return {key: _frozen(each) for key, each in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


def _centroids(given: Any) -> tuple[Any, ...]:
    return given["niches"], given["axes"]


def _points(centroids: Any) -> Json:
    return [[_finite(value) for value in point] for point in centroids]


def _index(value: Any) -> int:
    if isinstance(value, bool):
        raise TypeError(f"expected an index; got {value!r}")
    return operator.index(value)


def _finite(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise TypeError(f"expected a number; got {value!r}")
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"expected a finite number; got {number}")
    return number


@dataclasses.dataclass(frozen=True, slots=True)
class Method:
    """A method of a part that decides, between JSON and JSON."""

    name: str
    #: The function that makes the method's arguments of what is given.
    arguments: Callable[[Any], tuple[Any, ...]]
    #: The function that makes JSON of what the method returned; it raises where that is not an answer.
    answer: Callable[[Any], Json]


#: The methods, by kind and name.
METHODS: Mapping[str, Method] = {
    "parents.pool": Method("pool", _pool, _ids),
    "parents.draw": Method("draw", _draw_parents, _ids),
    "prompts.draw": Method("draw", _draw_prompt, _index),
    "temperatures.next": Method("next", _next, _finite),
    "fitness.of": Method("of", _of, _finite),
    "descriptors.describe": Method("describe", _describe_network, _finite),
    CENTROIDS: Method("centroids", _centroids, _points),
}


def _answer(header: Header) -> Json:
    made, method, given = _class(header), header["method"], header["given"]
    if method == "describe":
        return _describe(made, given["constants"])
    part = made(**header["settings"])  # which may refuse its settings
    if method == "check":
        return True
    asked = METHODS[method]
    return asked.answer(getattr(part, asked.name)(*asked.arguments(given)))
