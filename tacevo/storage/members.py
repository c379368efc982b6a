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

    Written as text, it is the place that errors name, such as `x.zip, run/run.json`. What lies in it, and whether it is
    there, is told from memory. All else that a path can do needs the disk, and raises `TypeError`: a member cannot be
    written, and no name leads out of a bundle.

    Args:
        path: the name of the file in errors.
        content: the bytes of a file or the tree of a directory; None where nothing is there.
        parent: the directory that it lies in; None for the first one, which is its own parent.
        name: its name in the bundle, or that of its run.
        between: stands between its place and the names in it.
    """

    #: The content of the member; None of what is not there, and of paths that were made otherwise than by `/`.
    _content: bytes | Tree | None = None
    _above: Self | None = None
    _name, _between = "", "/"

    def __new__(cls, path: str, *_: Any, **__: Any) -> Self:
        """Make the path of a place."""
        return super().__new__(cls, path)

    def __init__(
        self,
        path: str,
        content: bytes | Tree | None = None,
        *,
        parent: Self | None = None,
        name: str = "",
        between: str = "/",
    ) -> None:
        if sys.version_info >= (3, 12):
            super().__init__(path)
        self._content, self._above, self._name, self._between = content, parent, name, between

    def __fspath__(self) -> NoReturn:
        raise TypeError(f"expected a file on the disk; got {self}, a member of a bundle")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Member) and str(self) == str(other)

    def __hash__(self) -> int:
        return hash((Member, str(self)))

    def __truediv__(self, key: Any) -> Self:
        first, _, rest = str(key).partition("/")
        content = self._content.get(first) if isinstance(self._content, dict) else None
        child = type(self)(f"{self}{self._between}{first}", content, parent=self, name=first)
        return child / rest if rest else child

    def called(self, name: str) -> Self:
        """Return a run's directory, which every bundle calls `run`, under the name of the run."""
        return type(self)(str(self), self._content, parent=self._above, name=name)

    # What these give is what they give of any path.
    # ruff: noqa: D102

    @property
    def name(self) -> str:
        return self._name or super().name

    @property
    def parent(self) -> Self:
        return self if self._above is None else self._above

    @property
    def file(self) -> PosixPath:
        """The bundle itself, a file on the disk."""
        return PosixPath(str(self)) if self._above is None else self._above.file

    def exists(self, **_: Any) -> bool:
        return self._content is not None

    def is_file(self, **_: Any) -> bool:
        return isinstance(self._content, bytes)

    def is_dir(self, **_: Any) -> bool:
        return isinstance(self._content, dict)

    def is_symlink(self) -> bool:
        return False

    def resolve(self, strict: bool = False) -> Self:
        return self

    def stat(self, **_: Any) -> os.stat_result:
        """Return the size of a file; nothing else of it is true."""
        return os.stat_result((stat.S_IFREG, 0, 0, 0, 0, 0, len(self.read_bytes()), 0, 0, 0))

    def open(self, mode: str = "r", *_: Any, **__: Any) -> Any:
        if mode not in {"r", "rb"}:
            self.__fspath__()
        if not isinstance(self._content, bytes):
            raise FileNotFoundError(2, "No such file", str(self))
        file = io.BytesIO(self._content)
        return file if mode == "rb" else io.TextIOWrapper(file, encoding="utf-8")

    def iterdir(self) -> Generator[Self, None, None]:
        yield from (self / name for name in (self._content if isinstance(self._content, dict) else ()))

    def rglob(self, pattern: str) -> Generator[Self, None, None]:
        self.__fspath__()

    def glob(self, pattern: str) -> Generator[Self, None, None]:
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
