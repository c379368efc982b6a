"""`tacevo init NAME --part KIND`: a part of a user's own that works at once, with its test, to be edited."""

import contextlib
import keyword
import os
import re
import shlex
import shutil
import sys
from importlib.resources import files
from io import StringIO
from pathlib import Path
from token import NAME
from tokenize import generate_tokens

from tacevo.cli.common import DONE, tell
from tacevo.environment import as_typed
from tacevo.errors import ConfigError
from tacevo.parts.kinds import COMMANDS, DESCRIPTORS, KINDS, OUTPUTS, Kind
from tacevo.parts.registry import is_there
from tacevo.text import listed, nearest

#: Where parts are written, in the directory where a user stands.
_FOLDER = Path("parts")

#: What the search with a template needs beside it: that of images has labels of forces.
#: Names of files that pip and pytest take for their own.
_OF_TOOLS = ("setup", "conftest")

_BESIDE = {"sources": " task=force", "providers": " llm.model={name}"}

_TEST = """\
\"\"\"What every part of this kind promises holds for this one; add what yours is for.\"\"\"

import pytest
from {module} import {attribute}

from tacevo.parts.testing import contracts


@pytest.mark.parametrize("contract", contracts({made}), ids=str)
def test_{module}_keeps_its_contracts(contract):
    contract.check()
"""

#: Outputs and commands are found by an entry point only.
_PROJECT = """\
[build-system]
requires = ["setuptools>=64"]
build-backend = "setuptools.build_meta"

[project]
name = "tacevo-{module}"
version = "0.1"
dependencies = ["tacevo"]

[project.entry-points."{group}"]
{module} = "{module}:{attribute}"

[tool.setuptools]
py-modules = ["{module}"]
"""


def run_init_part(name: str, kind_name: str) -> int:
    """Write a part of a kind and its test, and say how it is tried."""
    kind = _kind(kind_name)
    is_packaged = kind in (OUTPUTS, COMMANDS)
    attribute = name if kind is COMMANDS else "".join(word.capitalize() for word in name.split("_"))
    template = (files("tacevo.cli.templates") / f"{kind.name}.py").read_text(encoding="utf-8")
    _check_name(name, attribute, template, kind if is_packaged else None)
    part = re.sub(r"\bMine\b", attribute, re.sub(r"\bmine\b", name, template))
    made = attribute if kind is COMMANDS else f"{attribute}()"
    names = {"module": name, "attribute": attribute, "made": made, "group": kind.group}
    folder = _FOLDER / name if is_packaged else _FOLDER
    texts = {folder / f"{name}.py": part, folder / f"test_{name}.py": _TEST.format(**names)}
    if is_packaged:
        texts[folder / "pyproject.toml"] = _PROJECT.format(**names)
    _write(texts)
    for file in texts:
        tell(f"wrote:  {file}{' (to edit)' if file.name == f'{name}.py' else ''}")
    for line in _next(kind, name, folder, f"{folder / name}.py:{attribute}"):
        tell(line)
    return DONE


def _kind(name: str) -> Kind:
    """Return a kind by its name, of one or of several: `descriptor` or `descriptors`."""
    kind = KINDS.get(name, KINDS.get(f"{name}s"))
    if kind is None:
        raise ConfigError(
            repr(name), place="--part", expected=f"one of {listed(KINDS)}", remedy=nearest(name, KINDS, "")
        )
    return kind


def _check_name(name: str, attribute: str, template: str, packaged: Kind | None) -> None:
    """Check that a name can be that of a module, of a class beside those that it needs, and of a part.

    Raises:
        ConfigError: it cannot.
    """
    remedy = "choose a name such as width"
    is_identifier = re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name) is not None
    if not is_identifier or keyword.iskeyword(name) or keyword.iskeyword(attribute):
        expected = "a lower-case identifier, which is no word of Python's own"
        raise ConfigError(repr(name), place="NAME", expected=expected, remedy=remedy)
    if name in sys.stdlib_module_names or name in _OF_TOOLS or is_there(name):
        raise ConfigError(name, place="NAME", expected="a name that no installed module has", remedy=remedy)
    used = {token.string for token in generate_tokens(StringIO(template).readline) if token.type == NAME}
    if attribute in used - {"Mine", "mine"}:
        expected = "a name that its module does not use for something else"
        raise ConfigError(attribute, place="NAME", expected=expected, remedy=remedy)
    if packaged and name in packaged.ours:
        raise ConfigError(
            name, place="NAME", expected=f"a name that none of tacevo's {packaged.name} has", remedy=remedy
        )


def _write(texts: dict[Path, str]) -> None:
    """Write all files or none; nothing that exists is changed.

    Raises:
        ConfigError: one is there already, or cannot be written.
    """
    if taken := [str(file) for file in texts if file.exists() or file.is_symlink()]:
        remedy = "choose another name, or remove what is there"
        raise ConfigError(listed(taken), place="NAME", expected="files that are not there yet", remedy=remedy)
    folder = next(iter(texts)).parent
    new_folders = [each for each in (folder, *folder.parents) if not each.exists()]
    made: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file, text in texts.items():
            with file.open("x", encoding="utf-8") as opened:  # what came in between stays as it is
                made.append(file)
                opened.write(text)
    except BaseException as error:
        for file in made:
            with contextlib.suppress(OSError):
                file.unlink(missing_ok=True)
        for each in new_folders:
            with contextlib.suppress(OSError):
                each.rmdir()
        if not isinstance(error, OSError):
            raise
        got, remedy = f"{error.strerror}; nothing was written", "make room there, or let yourself write there"
        expected = "a directory that can be written to"
        raise ConfigError(got, place=str(folder), expected=expected, remedy=remedy) from error


def _next(kind: Kind, name: str, folder: Path, found: str) -> list[str]:
    """Say what a user does with a new part, a line each."""
    tacevo, test = as_typed("tacevo"), f"test:   {_own('pytest')} {folder / f'test_{name}.py'}"
    if kind in (OUTPUTS, COMMANDS):
        added = f"add:    {_own('pip')} install -e {folder}"
        tried = f"{tacevo} {name} runs/NAME" if kind is COMMANDS else f"{tacevo} tables runs/NAME"
        return [test, added, f"verify: {tacevo} parts check {name}", f"try:    {tried}"]
    value = f"'{kind.setting}=[arch_div,{found}]'" if kind is DESCRIPTORS else f"{kind.setting}={found}"
    search = f"{tacevo} search experiment=demo {value}{_BESIDE.get(kind.name, '').format(name=name)}"
    return [f"verify: {tacevo} parts check {folder / name}.py", test, f"try:    {search}"]


def _own(command: str) -> str:
    """Spell a command of this environment of which a user's shell may find another one."""
    beside = Path(sys.executable).parent
    found = shutil.which(command)
    return command if found and Path(found).parent == beside else shlex.quote(os.path.relpath(beside / command))
