"""Directories of images: one class per directory, ordered, noticed when edited, refused when broken."""

from pathlib import Path

import pytest
from refusals import refused
from small_recordings import save_folder, save_image

from tacevo.data.sources.folder import Folder
from tacevo.errors import DataError


def test_classes_are_ordered_as_numbers_where_all_are_numbers(tmp_path: Path) -> None:
    """Spacings of 10 mm come after 2 mm, with any suffix and any depth of directories."""
    catalogue = save_folder(tmp_path, "10/a.png", "2/b.JPG", "2/deep/er/c.jpeg", "0.5/d.png").catalogue()
    assert catalogue.names == ("0.5", "2", "10")
    assert catalogue.labels.tolist() == [0, 1, 1, 2]
    assert len(catalogue.pictures) == 4


def test_classes_are_ordered_by_name_otherwise(tmp_path: Path) -> None:
    """One name that is not a number makes all of them text."""
    assert save_folder(tmp_path, "wood/a.png", "10/a.png", "2/a.png").catalogue().names == ("10", "2", "wood")


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    """Notes, hidden directories and files beside the classes are not images of a class."""
    source = save_folder(tmp_path, "a/1.png", "b/1.png", "beside.png", ".hidden/1.png")
    (tmp_path / "a" / "notes.txt").write_text("a rainy day")
    assert source.catalogue().labels.tolist() == [0, 1]


@pytest.mark.parametrize(
    "stray", ["a/.ipynb_checkpoints/1-checkpoint.png", "a/._1.png", "a/deep/.trash/deeper/1.png", "a/.hidden.png"]
)
def test_hidden_files_and_folders_within_a_class_are_no_images(tmp_path: Path, stray: str) -> None:
    """An editor's copy of an image would stand in two parts of a split; a system's stub is not an image at all."""
    source = save_folder(tmp_path / ".data", "a/1.png", "a/deep/2.png", "b/1.png")
    before = source.describe()
    (tmp_path / ".data" / stray).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / ".data" / stray).write_text("no image")
    assert source.describe() == before
    assert source.catalogue().labels.tolist() == [0, 0, 1]


def test_description_follows_content_and_not_place(tmp_path: Path) -> None:
    """A copy elsewhere is the same data set; an edited or renamed image makes another."""
    here, there = (
        save_folder(tmp_path / "here", "a/1.png", "b/1.png"),
        save_folder(tmp_path / "there", "a/1.png", "b/1.png"),
    )
    assert here.describe() == there.describe()
    save_image(tmp_path / "there" / "a" / "1.png", 99)
    edited = there.describe()
    (tmp_path / "there" / "a" / "1.png").rename(tmp_path / "there" / "a" / "2.png")
    assert here.describe() != edited != there.describe()


@pytest.mark.parametrize(
    ("root", "files", "place"),
    [
        ("absent", ("a/1.png",), "holds: a"),
        ("a/1.png", ("a/1.png",), "holds: 1.png"),
        (".", ("a.png",), "holds: a.png"),
        (".", ("a/1.png", "b/notes.txt"), "have no images (1 found): b"),
        (".", ("0.5/a.png", "0.50/b.png", "2/c.png"), "are there twice (1 found): 0.5"),
        (".", ("Wood/a.png", "wood/b.png", "2/c.png"), "are there twice (1 found): wood"),
        (".", ("1/a.png", "1.0/b.png", "2/c.png"), "are there twice (1 found): 1"),
        (
            ".",
            ("a/1.png", "a/1.PNG", "b/1.png"),
            "the case of their names only (1 found): 1.png",
        ),
    ],
)
def test_directory_of_no_classes_is_refused(tmp_path: Path, root: str, files: tuple[str, ...], place: str) -> None:
    """What is there is named; two directories of one class, and two names that are one elsewhere, are mistakes."""
    save_folder(tmp_path, *(name for name in files if not name.endswith(".txt")))
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    with pytest.raises(DataError) as told:
        Folder(root=tmp_path / root, image_size=16).describe()
    assert place in str(told.value)


def test_mixed_sizes_and_unreadable_images_are_named(tmp_path: Path) -> None:
    """Both are found from the headers, before anything is decoded."""
    source = save_folder(tmp_path, "a/1.png", "a/2.png", "b/1.png")
    save_image(tmp_path / "b" / "1.png", 0, size=(9, 8))
    with refused(DataError, got="2 have 8x8 pixels (width x height), others not (1 found): b/1.png 9x8"):
        source.catalogue()
    (tmp_path / "a" / "2.png").write_text("no image")
    with refused(DataError, got="cannot be read (1 found): a/2.png (is not an image of a known format)"):
        source.catalogue()


def test_names_that_look_like_numbers_but_are_none_are_text(tmp_path: Path) -> None:
    """A class called nan has no place among numbers."""
    assert save_folder(tmp_path, "nan/a.png", "10/a.png", "2/a.png").catalogue().names == ("10", "2", "nan")


def test_text_with_digits_is_no_number(tmp_path: Path) -> None:
    """Python reads 1_0 as ten; as names they are two classes."""
    assert save_folder(tmp_path, "1_0/a.png", "10/a.png").catalogue().names == ("10", "1_0")


def test_files_that_are_no_images_of_a_class_are_told(tmp_path: Path) -> None:
    """Another format, notes, and images beside the classes are left out, and named."""
    source = save_folder(tmp_path, "a/1.png", "b/deep/2.png", "beside.png", "a/3.bmp", ".hidden/4.png")
    ignored = [path.relative_to(tmp_path).as_posix() for path in source.catalogue().ignored]
    assert ignored == ["a/3.bmp", "beside.png"]


@pytest.mark.parametrize(
    ("parts", "inner"),
    [
        (("train", "val", "test"), "train"),
        (("Train", "Test"), "Train"),
        (("training", "VALIDATION"), "training"),
        (("valid", "test"), "test"),
        (("train",), "train"),
    ],
)
def test_parts_of_a_split_are_no_classes(tmp_path: Path, parts: tuple[str, ...], inner: str) -> None:
    """A network would learn who was in which part; the message has a root whose directories are classes."""
    source = save_folder(tmp_path, *(f"{part}/{name}/1.png" for part in parts for name in ("fine", "coarse")))
    (tmp_path / "annotations").mkdir()
    with refused(
        DataError, place="data.root", got="the parts of a split", remedy=f"data.root={tmp_path / inner} "
    ) as caught:
        source.describe()
    assert str(tmp_path) in caught.value.got
    assert Folder(root=tmp_path / inner, image_size=16).catalogue().names == ("coarse", "fine")


def test_parts_without_classes_have_no_right_root(tmp_path: Path) -> None:
    """Their images lie side by side, so no directory has one directory per class."""
    with refused(DataError, place="data.root", got="the parts of a split") as caught:
        save_folder(tmp_path, "train/1.png", "test/1.png").describe()
    assert "data.root=" not in caught.value.remedy


@pytest.mark.parametrize("names", [("test", "wood"), ("train", "car"), ("trains", "tests")])
def test_a_class_may_have_the_name_of_a_part(tmp_path: Path, names: tuple[str, ...]) -> None:
    """Beside other classes it is one of them."""
    assert save_folder(tmp_path, *(f"{name}/1.png" for name in names)).catalogue().names == tuple(sorted(names))
