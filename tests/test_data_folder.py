"""Image folders: one class per folder, ordered, decoded in one way, noticed when edited, refused when broken."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tacevo.data.folder import Folder
from tacevo.data.photos import decode
from tacevo.errors import DataError


def make(root: Path, *files: str) -> Folder:
    """Save a small picture under each name."""
    for number, name in enumerate(files):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (8, 8), (number, 0, 0)).save(root / name)
    return Folder(root=root, image_size=4)


def test_classes_are_ordered_as_numbers_where_all_are_numbers(tmp_path: Path) -> None:
    """Spacings of 10 mm come after 2 mm, with any suffix and any depth of folders."""
    catalogue = make(tmp_path, "10/a.png", "2/b.JPG", "2/deep/er/c.jpeg", "0.5/d.png").catalogue()
    assert catalogue.names == ("0.5", "2", "10")
    assert catalogue.labels.tolist() == [0, 1, 1, 2]
    assert len(catalogue.pictures) == 4


def test_classes_are_ordered_by_name_otherwise(tmp_path: Path) -> None:
    """One name that is no number makes all of them text."""
    assert make(tmp_path, "wood/a.png", "10/a.png", "2/a.png").catalogue().names == ("10", "2", "wood")


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    """Notes, hidden folders and files beside the classes are not images of a class."""
    source = make(tmp_path, "a/1.png", "b/1.png", "beside.png", ".hidden/1.png")
    (tmp_path / "a" / "notes.txt").write_text("a rainy day")
    assert source.catalogue().labels.tolist() == [0, 1]


def test_description_follows_content_and_not_place(tmp_path: Path) -> None:
    """A copy elsewhere is the same data set; an edited or renamed image makes another."""
    here, there = make(tmp_path / "here", "a/1.png", "b/1.png"), make(tmp_path / "there", "a/1.png", "b/1.png")
    assert here.describe() == there.describe()
    Image.new("RGB", (8, 8), (9, 9, 9)).save(tmp_path / "there" / "a" / "1.png")
    edited = there.describe()
    (tmp_path / "there" / "a" / "1.png").rename(tmp_path / "there" / "a" / "2.png")
    assert here.describe() != edited != there.describe()


@pytest.mark.parametrize(
    ("files", "message"), [((), "data.root is no folder"), (("a.png",), "has no folders; put the images of each class")]
)
def test_folder_without_classes_is_refused(tmp_path: Path, files: tuple[str, ...], message: str) -> None:
    """The message says what the root must hold."""
    with pytest.raises(DataError, match=message):
        make(tmp_path / "root", *files).describe()


def test_empty_classes_are_named(tmp_path: Path) -> None:
    """A class without images is a mistake, not a class."""
    source = make(tmp_path, "a/1.png")
    (tmp_path / "b").mkdir()
    with pytest.raises(DataError, match=r"have no images \(1 found\): b"):
        source.catalogue()


def test_image_becomes_square_rgb(tmp_path: Path) -> None:
    """Grey and oblong become three equal channels of the asked size."""
    Image.new("L", (20, 10), 77).save(tmp_path / "grey.png")
    picture = decode(tmp_path / "grey.png", 6)
    assert picture.shape == (3, 6, 6)
    assert picture.dtype == np.uint8
    assert (picture == 77).all()


def test_channels_come_first_in_the_order_rgb(tmp_path: Path) -> None:
    """A pure colour stays in its own channel, rows stay rows."""
    image = Image.new("RGB", (2, 2), (10, 20, 30))
    image.putpixel((1, 0), (99, 20, 30))
    image.save(tmp_path / "colour.png")
    picture = decode(tmp_path / "colour.png", 2)
    assert picture[:, 1, 1].tolist() == [10, 20, 30]
    assert picture[0].tolist() == [[10, 99], [10, 10]]


def test_orientation_note_of_the_camera_is_obeyed(tmp_path: Path) -> None:
    """A picture stored upside down (EXIF orientation 3) is turned upright."""
    image = Image.new("RGB", (2, 2))
    image.putpixel((0, 0), (255, 255, 255))
    exif = Image.Exif()
    exif[0x0112] = 3
    image.save(tmp_path / "turned.png", exif=exif)
    assert decode(tmp_path / "turned.png", 2)[0].tolist() == [[0, 0], [0, 255]]


def test_file_that_is_no_image_is_refused(tmp_path: Path) -> None:
    """Text and half a file are named as unreadable."""
    (tmp_path / "text.png").write_text("no image")
    with pytest.raises(DataError, match=r"text.png \(UnidentifiedImageError\)"):
        decode(tmp_path / "text.png", 4)
    Image.effect_noise((64, 64), 50).save(tmp_path / "whole.png")
    (tmp_path / "half.png").write_bytes((tmp_path / "whole.png").read_bytes()[:1500])
    with pytest.raises(DataError, match=r"half.png \("):
        decode(tmp_path / "half.png", 4)


def test_deep_images_are_refused_instead_of_cut_off(tmp_path: Path) -> None:
    """A depth map of 16 bits would lose almost all its values."""
    Image.fromarray(np.full((4, 4), 40_000, dtype=np.uint16)).save(tmp_path / "deep.png")
    with pytest.raises(DataError, match="more than 8 bits"):
        decode(tmp_path / "deep.png", 4)
