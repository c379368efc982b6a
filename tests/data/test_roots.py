"""Hints never replace the fault: a folder that may not be looked into is passed over."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from small_recordings import save_image, save_table

from tacevo.data.sources.folder import Folder
from tacevo.data.sources.hints import folders_in, glimpsed, holder, require_file, require_folder
from tacevo.data.sources.table import Table
from tacevo.errors import DataError

NOBODY = 65_534


@contextmanager
def as_a_user() -> Iterator[None]:
    """Give up root's right to look into everything, which would make these tests blind."""
    own = os.geteuid()
    if own == 0:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(own)


@pytest.fixture
def place() -> Iterator[Path]:
    """Make a folder that every user may enter, which pytest's own are not, with `closed` in it, which none may."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "closed").mkdir()
        save_image(folder / "closed" / "1.png", 0)
        (folder / "closed").chmod(0)
        yield folder


def test_closed_folder_holds_nothing_for_a_hint(place: Path) -> None:
    """Neither listing it nor looking for a name in it fails, and nobody is told that it is empty."""
    with as_a_user():
        assert glimpsed(place / "closed") == []
        assert folders_in(place / "closed") == "what cannot be listed (Permission denied)"
        assert holder(place, "1.png") is None


def test_closed_folder_below_the_root_hides_no_fault(place: Path) -> None:
    """The absent table is told, not the folder in which it was looked for in vain."""
    save_table(place / "set", "0.png,1,2,\n")
    source = Table(root=place, table="labels.csv", image_column="a", target_columns=("b",), image_size=16)
    with as_a_user(), pytest.raises(DataError, match=r"no table 'labels.csv' .*; it is in .*/set: set data.root="):
        source.describe()


def test_closed_folder_beside_the_root_hides_no_fault(place: Path) -> None:
    """A class beside that may not be looked into is no part of the advice; the others are."""
    for name in ("a", "b"):
        save_image(place / name / "1.png", 0)
    with as_a_user(), pytest.raises(DataError, match=r"one class of a, b; set data.root="):
        Folder(root=place / "a", image_size=16).describe()


def test_path_through_a_folder_that_lists_nothing_is_told_as_absent(place: Path) -> None:
    """The message names the last folder that is there, and says why it lists nothing."""
    (place / "half").mkdir()
    (place / "half").chmod(0o311)
    with (
        as_a_user(),
        pytest.raises(
            DataError,
            match=r"no folder: .*half is there, but has no absent; what it holds cannot be listed \(Permission",
        ),
    ):
        require_folder(place / "half" / "absent", "images")


def test_closed_folder_instead_of_an_archive_is_told_as_a_folder(place: Path) -> None:
    """It is said that a folder is no archive, and what can be seen of it."""
    with (
        as_a_user(),
        pytest.raises(DataError, match=r"is a folder, not a .npz archive: .*it holds none that can be seen"),
    ):
        require_file(place / "closed", ".npz")
