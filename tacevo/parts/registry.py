"""The registry of parts: ours, those of installed packages, and files that a user names.

Nothing is imported to list parts. One of ours is found first, so a package cannot take its name.
"""

import hashlib
import importlib
import importlib.util
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from traceback import extract_tb
from types import ModuleType
from typing import TYPE_CHECKING, Any

from tacevo.errors import ConfigError
from tacevo.parts.kinds import Kind
from tacevo.text import listed, nearest

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

#: A part in a file: `parts/parents.py:Lexicase`.
_IN_FILE = re.compile(r"(?P<file>.+\.py):(?P<name>[A-Za-z_]\w*)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A part, found by its name."""

    kind: Kind
    #: The name that a run records of the part, and that of its own settings: of a part in a file, the class's name.
    name: str
    #: The module that it is in, by its dotted name; of a part in a file, that of the file without `.py`.
    module: str
    attribute: str
    #: The origin of the part: `tacevo`, a distribution with its version, or a file.
    origin: str
    #: The file of a part in a file; None of another one.
    file: Path | None = None

    @property
    def is_ours(self) -> bool:
        """Whether it comes with tacevo."""
        return self.origin == "tacevo"

    def load(self) -> Any:
        """Import it into this process.

        Raises:
            ConfigError: something that it needs is not installed, its module has no such name, or raises.
        """
        try:
            module = import_file(self.file) if self.file else importlib.import_module(self.module)
        except ImportError as error:
            raise missing(error, place=self.place, extra=self.kind.extras.get(self.name, "")) from error
        except Exception as error:
            if self.is_ours:
                raise
            expected = "a module that can be imported"  # it is a stranger's, and may raise anything
            raise ConfigError(raised(error), place=self.place, expected=expected) from error
        if not hasattr(module, self.attribute):
            own = [name for name, made in vars(module).items() if getattr(made, "__module__", "") == module.__name__]
            remedy = nearest(self.attribute, own, f"it has {listed(own)}")
            raise ConfigError(self.attribute, place=self.place, expected="a name that its module has", remedy=remedy)
        return getattr(module, self.attribute)

    @property
    def place(self) -> str:
        """The setting that chose it, for an error."""
        return f"{self.kind.setting}={self.name}" if self.kind.setting else f"{self.kind.name}, {self.name}"


def names(kind: Kind) -> list[str]:
    """List the names of a kind's parts that are installed: ours first, and then those of packages."""
    return [*kind.ours, *(name for name in sorted(_installed(kind)) if name not in kind.ours)]


def parts(kind: Kind) -> list[Part]:
    """Find all parts of a kind, in the order of `names`, without those whose name several packages have."""
    return [find(kind, name) for name in names(kind) if name in kind.ours or len(_installed(kind)[name]) == 1]


def ours(kind: Kind) -> list[Part]:
    """Find the parts of a kind that come with tacevo."""
    return [find(kind, name) for name in kind.ours]


def find(kind: Kind, name: str) -> Part:
    """Find a part by its name, or by `FILE.py:CLASS`; nothing is imported.

    Raises:
        ConfigError: there is none of this name, there are several, or the file is not there.
    """
    if name in kind.ours:
        module, _, attribute = kind.ours[name].partition(":")
        return Part(kind=kind, name=name, module=module, attribute=attribute, origin="tacevo")
    if match := _IN_FILE.fullmatch(name):
        return _in_file(kind, Path(match["file"]), match["name"])
    found = _installed(kind).get(name, ())
    if len(found) == 1:
        return _of(kind, found[0])
    if found:
        sellers = " and ".join(sorted(_of(kind, point).origin for point in found))
        raise ConfigError(f"{name}, which {sellers} have", place=kind.setting, expected="a part of one package")
    known = names(kind)
    remedy = nearest(name, known, f"`tacevo parts {kind.name}` lists them")
    if "(" in name:  # as of a call
        remedy = "give settings of a part apart, as `parts.CLASS.FIELD=VALUE`"
    expected = f"one of {', '.join(known)}, or FILE.py:CLASS"
    raise ConfigError(repr(name), place=kind.setting, expected=expected, remedy=remedy)


def load(kind: Kind, name: str) -> Any:
    """Find a part, and import it; errors are those of `find` and `Part.load`."""
    return find(kind, name).load()


def of_settings(kind: Kind, name: str, settings: object) -> Any:
    """Make one of ours: its fields are settings of these names of the group that chooses it, e.g. `proposals`."""
    part = load(kind, name)
    return part(**{field.name: getattr(settings, field.name) for field in fields(part)})


def shadowed(kind: Kind) -> Sequence[Part]:
    """Find the parts of installed packages that are never used, because one of ours has their name."""
    return [_of(kind, point) for name in kind.ours for point in _installed(kind).get(name, ())]


def ambiguous(kind: Kind) -> Sequence[Part]:
    """Find the parts of installed packages that cannot be used by name, because several packages have it."""
    several = (points for name, points in sorted(_installed(kind).items()) if name not in kind.ours and len(points) > 1)
    return [_of(kind, point) for points in several for point in points]


@cache
def _installed(kind: Kind) -> "dict[str, tuple[EntryPoint, ...]]":
    """Return the entry points of a kind's group, by name."""
    from importlib.metadata import entry_points  # which takes a while, and most commands name ours

    by_name: dict[str, tuple[EntryPoint, ...]] = {}
    for point in entry_points(group=kind.group):
        by_name[point.name] = (*by_name.get(point.name, ()), point)
    return by_name


def _of(kind: Kind, point: "EntryPoint") -> Part:
    distribution = point.dist
    origin = "an unknown package" if distribution is None else f"{distribution.name} {distribution.version}"
    return Part(kind=kind, name=point.name, module=point.module, attribute=point.attr, origin=origin)


def _in_file(kind: Kind, file: Path, name: str) -> Part:
    if not file.is_file():
        raise ConfigError(str(file), place=kind.setting, expected="a file that is there")
    return Part(kind=kind, name=name, module=file.stem, attribute=name, origin=str(file), file=file)


def import_file(file: Path) -> ModuleType:
    """Import a file as a module of a name that no other file has; what lies beside it can be imported by it, too."""
    path = file.resolve()
    name = f"tacevo_part_{file.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None  # the file ends with .py
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # behind all that is installed
    sys.modules[name] = module  # where a dataclass looks the types of its fields up
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def raised(error: BaseException, file_of_part: Path | None = None) -> str:
    """Say what code of a user's raised, and in which line: the last of its own file, where that is known."""
    frames = extract_tb(error.__traceback__)
    own = [frame for frame in frames if file_of_part is not None and _is_same(Path(frame.filename), file_of_part)]
    last = (own or frames)[-1]
    file, line = (error.filename, error.lineno) if isinstance(error, SyntaxError) else (last.filename, last.lineno)
    said = error.msg if isinstance(error, SyntaxError) else str(error)
    return f"{type(error).__name__}: {said}, {Path(file or '').name}, line {line}"


def _is_same(file: Path, other: Path) -> bool:
    """Answer whether two paths lead to one file, or are those of a part's file here and where it is confined."""
    return file.resolve() == other.resolve() or (not file.exists() and file.name == other.name)


#: The extra of tacevo that installs a library which `pip install tacevo` does not.
EXTRAS = {
    "ray": "ray",
    "openai": "openai",
    "submitit": "slurm",
    **dict.fromkeys(("onnx", "onnxruntime", "onnxscript", "safetensors"), "export"),
}


def is_there(module: str) -> bool:
    """Answer whether a module of a part, or of a library, is installed; it is not imported."""
    try:
        return importlib.util.find_spec(module) is not None
    except ImportError:  # not even what it lies in
        return False


@contextmanager
def needing_parts() -> Iterator[None]:
    """Let a block, or a function that this decorates, import what may be left out.

    Raises:
        ConfigError: a part, or a library of it, is not installed; as `missing` says it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise missing(error) from error


def missing(error: ImportError, *, place: str = "", extra: str = "") -> ConfigError:
    """Say in one line what is not installed, and how it is; `extra` installs what a part needs."""
    from tacevo.environment import install

    name = (error.name or "") if isinstance(error, ModuleNotFoundError) else ""  # else it is there, and lacks something
    library = name.partition(".")[0]
    extra = EXTRAS.get(library, "" if library in {"tacevo", "analysis"} else extra)
    if extra:
        remedy = install(extra)
    elif library in {"tacevo", "analysis"}:
        remedy = "this installation of tacevo was made without that part; in a clone: pip install -e ."
    else:
        remedy = f"install {library}" if library else ""
    got = f"no module {name}" if name else str(error)
    return ConfigError(got, place=place, expected="what it needs to be installed", remedy=remedy)
