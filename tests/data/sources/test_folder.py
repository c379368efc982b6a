"""Directories of images: one class per directory, in order; what is no class is refused."""

from pathlib import Path

import pytest
from refusals import refused
from small_recordings import save_folder

from tacevo.data.sources.folder import Folder
from tacevo.errors import DataError


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (("10/a.png", "2/b.JPG", "2/deep/er/c.jpeg", "0.5/d.png"), ("0.5", "2", "10")),
        (("wood/a.png", "10/a.png", "2/a.png"), ("10", "2", "wood")),
        (("nan/a.png", "10/a.png", "2/a.png"), ("10", "2", "nan")),
        (("1_0/a.png", "10/a.png"), ("10", "1_0")),
    ],
)
def test_classes_are_ordered_as_numbers_where_all_are_numbers(
    tmp_path: Path, files: tuple[str, ...], names: tuple[str, ...]
) -> None:
    """Spacings of 10 mm come after 2 mm; one name that is no number, as a person writes one, makes all of them text."""
    assert save_folder(tmp_path, *files).catalogue().names == names


def test_root_may_be_hidden_and_names_enter_the_key(tmp_path: Path) -> None:
    """Only what is hidden below it is passed over; an image of another name stands elsewhere in the order."""
    source = save_folder(tmp_path / ".data", "a/1.png", "a/deep/2.png", "b/1.png")
    assert source.catalogue().labels.tolist() == [0, 0, 1]
    before = source.describe()
    (tmp_path / ".data" / "a" / "1.png").rename(tmp_path / ".data" / "a" / "0.png")
    assert source.describe() != before


@pytest.mark.parametrize(
    ("root", "files", "place"),
    [
        ("absent", ("a/1.png",), "holds: a"),
        ("a/1.png", ("a/1.png",), "holds: 1.png"),
        (".", ("a.png",), "holds: a.png"),
        (".", ("a/1.png", "b/notes.txt"), "have no images (1 found): b"),
        (".", ("0.5/a.png", "0.50/b.png", "2/c.png"), "are there twice (1 found): 0.5"),
        (".", ("Wood/a.png", "wood/b.png", "2/c.png"), "are there twice (1 found): wood"),
        (".", ("a/1.png", "a/1.PNG", "b/1.png"), "of their names only (1 found): 1.png"),
    ],
)
def test_directory_of_no_classes_is_refused(tmp_path: Path, root: str, files: tuple[str, ...], place: str) -> None:
    """What is there is named; two directories of one class, and two names that are one elsewhere, are mistakes."""
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    with pytest.raises(DataError) as told:
        Folder(root=tmp_path / root, image_size=16).describe()
    assert place in str(told.value)


@pytest.mark.parametrize("parts", [("train", "val", "test"), ("Train", "Test"), ("training", "VALIDATION"), ("train",)])
def test_parts_of_a_split_are_no_classes(tmp_path: Path, parts: tuple[str, ...]) -> None:
    """A network would learn who was in which part; directories without images beside them change nothing."""
    source = save_folder(tmp_path, *(f"{part}/{name}/1.png" for part in parts for name in ("fine", "coarse")))
    (tmp_path / "annotations").mkdir()
    with refused(DataError, place="data.root", got=f"{tmp_path}, which holds ", remedy="data.root to a part"):
        source.describe()
    assert Folder(root=tmp_path / parts[0], image_size=16).catalogue().names == ("coarse", "fine")


@pytest.mark.parametrize("names", [("test", "wood"), ("car", "train"), ("tests", "trains")])
def test_a_class_may_have_the_name_of_a_part(tmp_path: Path, names: tuple[str, ...]) -> None:
    """Beside other classes it is one of them."""
    assert save_folder(tmp_path, *(f"{name}/1.png" for name in names)).catalogue().names == names
