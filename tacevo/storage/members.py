"""Files of a bundle in memory, which are read by the words that read those of a directory."""

import io
import os
import stat
import sys
from collections.abc import Generator, Mapping
from fnmatch import fnmatchcase
from pathlib import PosixPath
from typing import Any, NoReturn, Self, Union

#: The contents of a directory, by name.
Tree = dict[str, Union[bytes, "Tree"]]


class Member(PosixPath):
    """A file or a directory of a bundle, which is not on the disk.

    Written as text, it is the place that errors name, such as `x.zip, run/run.json`. What lies in it and beside it, and
    whether it is there, is told from memory. All else that a path can do needs the disk, and raises `TypeError`: a
    member cannot be written, and no name leads out of a bundle.

    Args:
        place: what errors name.
        content: the bytes of a file or the tree of a directory; None where nothing is there.
        parent: the directory that it lies in; None for the first one, which is its own parent.
        name: its name in the bundle, or that of its run.
        between: stands between its place and the names in it.
    """

    #: What is not there; so are paths that were made otherwise than by `/`.
    _content: bytes | Tree | None = None
    _above: Self | None = None
    _name = ""
    _between = "/"

    def __new__(cls, place: str, *_: Any, **__: Any) -> Self:
        """Make the path of a place."""
        return super().__new__(cls, place)

    def __init__(
        self,
        place: str,
        content: bytes | Tree | None,
        *,
        parent: Self | None = None,
        name: str = "",
        between: str = "/",
    ) -> None:
        if sys.version_info >= (3, 12):
            super().__init__(place)
        self._content = content
        self._above = parent
        self._name = name
        self._between = between

    def __fspath__(self) -> NoReturn:
        raise TypeError(f"expected a file on the disk; got {self}, a member of a bundle")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Member) and str(self) == str(other)

    def __hash__(self) -> int:
        return hash((Member, str(self)))

    @property
    def name(self) -> str:
        """Its name in the bundle, or that of its run."""
        return self._name or super().name

    @property
    def parent(self) -> Self:
        """The directory that it lies in."""
        return self if self._above is None else self._above

    def named(self, name: str) -> Self:
        """Return the directory of a run, which every bundle calls `run`, under the name of the run."""
        return type(self)(str(self), self._content, parent=self._above, name=name)

    def __truediv__(self, key: Any) -> Self:
        first, _, rest = str(key).partition("/")
        content = self._content.get(first) if isinstance(self._content, dict) else None
        child = type(self)(f"{self}{self._between}{first}", content, parent=self, name=first)
        return child / rest if rest else child

    def exists(self, **_: Any) -> bool:
        """Return whether it is there."""
        return self._content is not None

    def is_file(self, **_: Any) -> bool:
        """Return whether it is a file that is there."""
        return isinstance(self._content, bytes)

    def is_dir(self, **_: Any) -> bool:
        """Return whether it is a directory that is there."""
        return isinstance(self._content, dict)

    def is_symlink(self) -> bool:
        """Return False: a bundle has no links."""
        return False

    def resolve(self, strict: bool = False) -> Self:
        """Return itself."""
        return self

    def stat(self, **_: Any) -> os.stat_result:
        """Return the size of a file, and nothing else that is true."""
        return os.stat_result((stat.S_IFREG, 0, 0, 0, 0, 0, len(self.read_bytes()), 0, 0, 0))

    def open(self, mode: str = "r", *_: Any, **__: Any) -> Any:
        """Open a file to be read."""
        if mode not in {"r", "rb"}:
            self.__fspath__()
        file = io.BytesIO(self.read_bytes())
        return file if mode == "rb" else io.TextIOWrapper(file, encoding="utf-8")

    def read_bytes(self) -> bytes:
        """Read a file."""
        if not isinstance(self._content, bytes):
            raise FileNotFoundError(2, "No such file", str(self))
        return self._content

    def read_text(self, *_: Any, **__: Any) -> str:
        """Read a file as text, in UTF-8."""
        return str(self.open().read())

    def iterdir(self) -> Generator[Self, None, None]:
        """Yield what lies in a directory; nothing where there is none."""
        yield from (self / name for name in (self._content if isinstance(self._content, dict) else ()))

    def glob(self, pattern: str) -> Generator[Self, None, None]:
        """Yield what lies below it under names of a pattern, such as `studies/*/study.json`."""
        first, _, rest = pattern.partition("/")
        for child in self.iterdir():
            if fnmatchcase(child.name, first):
                yield from child.glob(rest) if rest else (child,)


def as_tree(files: Mapping[str, bytes]) -> Tree:
    """Return the directory that files of these names lie in, such as `studies/one/study.json`."""
    tree: Tree = {}
    for name, data in files.items():
        *folders, last = name.split("/")
        inner = tree
        for folder in folders:
            below = inner.setdefault(folder, {})
            assert isinstance(below, dict)  # whoever names files gives none the name of another one's directory
            inner = below
        inner[last] = data
    return tree
