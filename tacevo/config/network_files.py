"""The files of networks that a user gives, for a study of them or for the first generation of a search."""

import glob
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from tacevo.config.conf_folder import config_roots
from tacevo.errors import ConfigError
from tacevo.records import Given

#: The pattern for the name of a given network, since tables, figures and file names bear its name.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,39}")


def read_networks(names: Sequence[str], place: str = "networks") -> dict[Path, Given]:
    """Read the files that paths, directories and patterns name, in this order, each of a name of its own.

    A relative name is looked up here and then in the directories of configs. `place` is the setting that has the names.

    Raises:
        ConfigError: a name matches no file, a file cannot be read, or two networks would have one name.
    """
    return dict(_files(names, place))


def _files(names: Sequence[str], place: str) -> Iterator[tuple[Path, Given]]:
    known: dict[str, Path] = {"baseline": Path("the task's baseline, which every study has")}
    for path in (path for name in names for path in _paths(name, place)):
        label = path.stem
        if _NAME.fullmatch(label) is None:
            expected = "a file name of up to 40 letters, digits, spaces, '.', '_' and '-': it is the network's name"
            raise ConfigError(repr(label), place=f"{place}, {path}", expected=expected, remedy="rename the file")
        if label in known:
            expected = "files of different names, which are the networks' names"
            raise ConfigError(f"{known[label]} and {path}", place=place, expected=expected, remedy="rename one")
        known[label] = path
        try:
            yield path, Given(name=label, source=path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(str(error), place=f"{place}, {path}", expected="a network: text in UTF-8") from error


def _paths(name: str, place: str) -> list[Path]:
    """List the files behind a name: a file, those of a directory, or those of a pattern, by name.

    A relative name is looked up here and then in the directories of configs, so that the shipped networks are found
    from anywhere.
    """
    for root in (Path(), *config_roots()):
        path = root / name
        pattern = f"{glob.escape(str(path))}/*.py" if path.is_dir() else str(path)
        if files := sorted(map(Path, glob.glob(pattern))):
            return files
    expected = "a file of a network, a directory of .py files, or a pattern such as 'nets/*.py'"
    raise ConfigError(f"{name}, which matches no file", place=place, expected=expected)
