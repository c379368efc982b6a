"""The sources of a part that decides, read without running them: its module and what that imports of its own.

A run records them, and nothing else of the part is ever executed: an import of anything but these and `ALLOWED` fails.
"""

import ast
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path, PurePosixPath

from tacevo.errors import ConfigError
from tacevo.parts.kinds import MOST_BYTES, MOST_FILES
from tacevo.parts.protocols import ALLOWED, is_allowed
from tacevo.parts.registry import Part

#: Names that no module of a part may have: another one would be imported in its place.
_TAKEN = sys.stdlib_module_names | {"numpy", "tacevo"}

#: Sources by their hash: a configuration names a part by that, and the run writes them into its directory.
_REMEMBERED: dict[str, dict[str, str]] = {}


@dataclass(frozen=True, slots=True)
class _Import:
    """An import statement."""

    #: Dotted, from the top, as far as it is a module or may be one.
    module: str
    line: int


def read_sources(part: Part) -> dict[str, str]:
    """Read the text of a part's module, and of those of its package, or beside its file, that it imports.

    Returns:
        By their place below the directory that the part is imported from, as in `mylab/parents.py`, in that order.

    Raises:
        ConfigError: a file cannot be read, is no Python, or imports what a part that decides may not.
    """
    root, own = _root(part)
    if part.file is not None and not part.file.stem.isidentifier():
        raise ConfigError(part.file.name, place=part.place, expected="a file whose name is a name in Python")
    texts: dict[str, str] = {}
    pending = [part.module]
    while pending:
        module = pending.pop()
        for file in _files(root, module):
            if file.as_posix() in texts:
                continue
            if file.parts[0].removesuffix(".py") in _TAKEN:
                expected = "another name: Python or a library has a module of this one"
                raise ConfigError(str(file), place=part.place, expected=expected)
            text = texts[file.as_posix()] = _read(part, root / file)
            _check_size(part, texts)
            for each in _imports(f"{part.place}, {file}", file, text):
                if _is_own(root, own, each.module):
                    pending.append(each.module)
                else:
                    _check_allowed(each, f"{part.place}, {file}")
    return {name: texts[name] for name in sorted(texts)}


def check_texts(place: str, texts: Mapping[str, str]) -> None:
    """Check recorded sources as `read_sources` checks those that it reads; errors are its."""
    modules = {name.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for name in texts}
    tops = {module.partition(".")[0] for module in modules}
    for name, text in texts.items():
        for each in _imports(f"{place}, {name}", PurePosixPath(name), text):
            if each.module.partition(".")[0] not in tops:
                _check_allowed(each, f"{place}, {name}")


def _check_allowed(imported: _Import, place: str) -> None:
    if not is_allowed(imported.module):
        raise ConfigError(
            f"`import {imported.module}`",
            place=f"{place}, line {imported.line}",
            expected=f"imports of its own modules, and of {', '.join(sorted(ALLOWED))}",
            remedy="what a part decides must follow from what it is given: draw from `rng`, and read no clock and no "
            "file; where its package imports more in an `__init__`, move the part to a package that does not",
        )


def files_of(part: Part) -> list[Path]:
    """List the files that an import of a part's module runs, its own last; none of them is run.

    Raises:
        ConfigError: its package is not installed with its sources.
    """
    root, _ = _root(part)
    return [root / file for file in _files(root, part.module)]


def code_files(part: Part) -> dict[str, Path]:
    """List the Python files of a part's package, or beside its file, by their place below where it is imported from.

    Raises:
        ConfigError: its package is not installed with its sources.
    """
    root, own = _root(part)
    package = root / own
    files = (
        root.glob("*.py") if not own else package.rglob("*.py") if package.is_dir() else [package.with_suffix(".py")]
    )
    return {file.relative_to(root).as_posix(): file for file in sorted(files)}


def remember(sha256: str, sources: Mapping[str, str]) -> None:
    """Keep the sources of a part in this process, by the hash that a configuration records of them."""
    _REMEMBERED[sha256] = dict(sources)


def recalled(sha256: str) -> Mapping[str, str] | None:
    """Return the sources of a hash, where composing has read them in this process."""
    return _REMEMBERED.get(sha256)


def _root(part: Part) -> tuple[Path, str]:
    """Return the directory that a part is imported from, and its package; empty for a file of no package."""
    if part.file is not None:
        return part.file.parent, ""
    top = part.module.partition(".")[0]
    spec = find_spec(top)  # of the top alone, as of others the packages above them would run
    if spec is not None and spec.origin is not None:
        path = Path(spec.origin)
        return (path.parent.parent if spec.submodule_search_locations else path.parent), top
    for folder in (spec and spec.submodule_search_locations) or ():  # of a namespace, which several packages share
        if (root := Path(folder).parent) and any(_files(root, part.module)):
            return root, top
    expected = "a part whose package is installed with its sources"
    raise ConfigError(f"no module {part.module if spec else top}", place=part.place, expected=expected)


def _files(root: Path, module: str) -> Iterator[PurePosixPath]:
    """Yield the files that an import of a module runs: those of the packages above it, and its own."""
    names = module.split(".")
    for depth in range(1, len(names) + 1):
        path = PurePosixPath(*names[:depth])
        for file in (path / "__init__.py", path.with_name(f"{path.name}.py")):
            if (root / file).is_file():
                yield file
                break


def _is_own(root: Path, own: str, module: str) -> bool:
    """Answer whether a module is the part's: of its package, or, of a part in a file, one that lies beside it."""
    top = module.partition(".")[0]
    if own:
        return top == own
    return not is_allowed(module) and (any(_files(root, module)) or _is_namespace(root, module))


def _is_namespace(root: Path, module: str) -> bool:
    """Answer whether a module is a directory of modules without an `__init__.py`."""
    return any(root.joinpath(*module.split(".")).glob("*.py"))


def _imports(place: str, file: PurePosixPath, text: str) -> Iterator[_Import]:
    """Yield what a text imports, wherever it does; refuse what is no Python, the clock of NumPy, and `id`."""
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ConfigError(str(error) or "text that is nested too deeply", place=place, expected="Python") from error
    package = list(file.parent.parts)
    has_own_id = any(map(_binds_id, ast.walk(tree)))
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id == "id" and not has_own_id:
            expected = "no address of an object, which is another one in each process"
            raise ConfigError("`id`", place=f"{place}, line {node.lineno}", expected=expected)
        if isinstance(node, ast.Attribute | ast.Constant | ast.alias) and _is_clock(node):
            line = getattr(node, "lineno", 0)
            raise ConfigError("NumPy's dates, which read a clock", place=f"{place}, line {line}", expected="no clock")
        if isinstance(node, ast.Import):
            yield from (_Import(alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            named = [f"{base}.{alias.name}" for alias in node.names]
            if base and not all(map(is_allowed, named)):  # else it is a package of which only these are imported
                yield _Import(base, node.lineno)
            for alias in node.names:  # each may be a module, which `_files` then finds
                yield _Import(".".join(filter(None, (base, alias.name))), node.lineno)


def _binds_id(node: ast.AST) -> bool:
    """Answer whether this gives the name `id` a meaning of its own."""
    if isinstance(node, ast.Name):
        return node.id == "id" and not isinstance(node.ctx, ast.Load)
    if isinstance(node, ast.alias):
        return (node.asname or node.name) == "id"
    return getattr(node, "arg" if isinstance(node, ast.arg) else "name", None) == "id"


def _is_clock(node: ast.Attribute | ast.Constant | ast.alias) -> bool:
    """Answer whether this names NumPy's type of dates, of which `now` and `today` are values."""
    named = {ast.Attribute: "attr", ast.Constant: "value", ast.alias: "name"}[type(node)]
    return re.match(r"[<>=|]?M8|datetime64", str(getattr(node, named))) is not None


def _read(part: Part, path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(str(error), place=part.place, expected="sources that can be read, in UTF-8") from error


def _check_size(part: Part, texts: Mapping[str, str]) -> None:
    size = sum(len(text.encode()) for text in texts.values())
    if size > MOST_BYTES or len(texts) > MOST_FILES:
        expected = f"at most {MOST_FILES} files of {MOST_BYTES} bytes together"
        raise ConfigError(f"{len(texts)} files of {size} bytes", place=part.place, expected=expected)
