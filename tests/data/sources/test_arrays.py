"""NumPy archives: floats are values, whole numbers classes; nothing is unpickled, and every broken array is named."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from small_recordings import save_arrays

from tacevo.data.sources.arrays import Arrays
from tacevo.errors import DataError
from tacevo.records import Kind

IMAGES = np.random.Generator(np.random.Philox(0)).integers(0, 256, (12, 8, 6, 3)).astype(np.uint8)
CLASSES = np.arange(12) % 3

#: The header of an array of 2^60 bytes.
HUGE = (
    b"\x93NUMPY\x01\x00\x76\x00"
    + f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({1 << 60},), }}".encode().ljust(117)
    + b"\n"
)


def test_floats_are_regressed(tmp_path: Path) -> None:
    """One column needs no second axis, and gets a name."""
    catalogue = save_arrays(tmp_path / "set.npz").catalogue()
    assert (catalogue.kind, catalogue.names, catalogue.groups) == (Kind.regression, ("label 0",), None)
    assert catalogue.labels.tolist() == [[value] for value in np.linspace(0, 1, 12)]
    assert len(catalogue.pictures) == 12


def test_whole_numbers_are_classes(tmp_path: Path) -> None:
    """Classes without names are called by their numbers."""
    catalogue = save_arrays(tmp_path / "set.npz", labels=CLASSES.astype(np.uint8)).catalogue()
    assert (catalogue.kind, catalogue.names) == (Kind.classification, ("0", "1", "2"))
    assert catalogue.labels.dtype == np.int64
    assert catalogue.labels.tolist() == CLASSES.tolist()


def test_names_are_taken(tmp_path: Path) -> None:
    """They name classes and values alike."""
    names = np.array(["felt", "wood", "wool"])
    assert save_arrays(tmp_path / "a.npz", labels=CLASSES, names=names).catalogue().names == ("felt", "wood", "wool")
    values = np.ones((12, 2), dtype=np.float32)
    named = save_arrays(tmp_path / "b.npz", labels=values, names=np.array(["fx", "fy"])).catalogue()
    assert (named.names, named.labels.shape) == (("fx", "fy"), (12, 2))
    assert named.labels.dtype == np.float64


def test_pixels_of_the_asked_size_are_unchanged(tmp_path: Path) -> None:
    """Channels come first; nothing else is done to them."""
    images = np.random.default_rng(0).integers(0, 256, (12, 16, 16, 3)).astype(np.uint8)
    pictures = save_arrays(tmp_path / "set.npz", images=images).catalogue().pictures
    assert np.array_equal(pictures[5](), images[5].transpose(2, 0, 1))


@pytest.mark.parametrize("shape", [(12, 16, 16), (12, 16, 16, 1)])
def test_grey_is_repeated(tmp_path: Path, shape: tuple[int, ...]) -> None:
    """With and without an axis of its own, grey becomes three equal channels."""
    images = np.arange(12 * 256, dtype=np.uint8).reshape(shape)
    picture = save_arrays(tmp_path / "set.npz", images=images).catalogue().pictures[3]()
    assert np.array_equal(picture, np.stack([images[3].reshape(16, 16)] * 3))


NAN_ROWS = np.array([[0.0, 1.0], [np.nan, 1.0], [0.0, np.inf]] * 4)


@pytest.mark.parametrize(
    ("arrays", "place", "words"),
    [
        ({"images": None, "labels": None, "names": np.array(["a"])}, "", "lacks arrays (2 found): images, labels"),
        ({"group": np.arange(12)}, "", "unknown arrays (1 found): group"),
        ({"images": IMAGES.astype(np.uint16)}, "images", "uint16 of shape (12, 8, 6, 3)"),
        ({"images": IMAGES.transpose(0, 3, 1, 2)}, "images", "uint8 of shape (12, 3, 8, 6)"),
        ({"images": IMAGES[0, :, :, 0]}, "images", "uint8 of shape (8, 6)"),
        ({"images": np.zeros((12, 0, 8), dtype=np.uint8)}, "images", "shape (12, 0, 8)"),
        ({"labels": np.zeros(11)}, "labels", "shape (11,)"),
        ({"labels": np.float64(1)}, "labels", "shape ()"),
        ({"labels": np.zeros((12, 2, 2))}, "labels", "float64 of shape (12, 2, 2)"),
        ({"labels": np.zeros((12, 0))}, "labels", "float64 of shape (12, 0)"),
        ({"labels": np.array(["a"] * 12)}, "labels", "<U1"),
        ({"labels": np.zeros(12, np.longdouble)}, "labels", "float128"),
        ({"labels": NAN_ROWS}, "", "not finite numbers (8 found): row 1 is [nan, 1.0], row 2 is [0.0, inf], row 4"),
        ({"labels": CLASSES.reshape(12, 1)}, "labels", "integers of shape (12, 1)"),
        ({"labels": CLASSES - 1}, "", "from 0 without a gap (4 found): row 0 is -1, row 3 is -1, row 6 is -1, row 9"),
        ({"labels": CLASSES * 2}, "", "from 0 without a gap (4 found): row 2 is 4"),
        ({"labels": CLASSES, "names": np.array(["a", "b"])}, "", "(4 found): row 2 is 2"),
        ({"labels": CLASSES, "names": np.array(list("abcd"))}, "", "some classes have no images (1 found): 3"),
        ({"labels": CLASSES, "names": np.array(["a", "b", "a"])}, "names", "['a', 'b', 'a']"),
        ({"names": np.array([1.0])}, "names", "float64"),
        ({"names": np.array(["a", "b"])}, "names", "<U1 of shape (2,)"),
        ({"groups": np.zeros(11, dtype=int)}, "groups", "shape (11,)"),
        ({"groups": np.zeros(12)}, "groups", "float64"),
        ({"groups": np.zeros((12, 1), dtype=int)}, "groups", "int64 of shape (12, 1)"),
        ({"labels": np.array([print] * 12, dtype=object)}, "set.npz, labels", "cannot be loaded"),
    ],
)
def test_broken_arrays_are_named(tmp_path: Path, arrays: dict[str, Any], place: str, words: str) -> None:
    """The error says which array, and what it is."""
    with refused(DataError, place=place, got=words):
        save_arrays(tmp_path / "set.npz", **arrays).catalogue()


@pytest.mark.parametrize("content", [b"\x80\x04N.", b"", b"\x93NUMPY\x01\x00", b"PK\x03\x04 and no more"])
def test_file_that_is_not_an_archive_is_refused(tmp_path: Path, content: bytes) -> None:
    """A pickle, an empty file, a single array, or the beginning of a zip file."""
    path = tmp_path / "set.npz"
    path.write_bytes(content)
    with refused(DataError, place=str(path), expected="a NumPy archive", remedy="save images and labels together"):
        Arrays(root=path, image_size=16).catalogue()


@pytest.mark.parametrize(
    ("sound", "damaged", "place"),
    [(b"PK\x01\x02", b"PK\x01\xff", "set.npz"), (bytes(range(40)), bytes(range(1, 41)), "set.npz, images")],
    ids=["list of arrays", "pixels"],
)
def test_damaged_archive_is_refused(tmp_path: Path, sound: bytes, damaged: bytes, place: str) -> None:
    """The list of its arrays stands at its end; a changed byte of an array is noticed by its checksum."""
    source = save_arrays(tmp_path / "set.npz")
    content = source.root.read_bytes()
    assert sound in content
    source.root.write_bytes(content.replace(sound, damaged))
    with refused(DataError, place=place, got="cannot be read", remedy="save images and labels together"):
        source.catalogue()


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("sets.npz", "holds: empty, set.npz; did you mean"), (".", "holds: empty, set.npz"), ("empty", "holds: nothing")],
)
def test_wrong_root_says_what_is_there(tmp_path: Path, name: str, remedy: str) -> None:
    """The archive is a file; where it is not found, the entries of the directory are named."""
    save_arrays(tmp_path / "set.npz")
    (tmp_path / "empty").mkdir()
    with refused(DataError, place="data.root", expected="a NumPy archive", remedy=remedy):
        Arrays(root=tmp_path / name, image_size=16).describe()


@pytest.mark.parametrize(
    ("member", "content", "got"),
    [
        ("images", b"pixels", "bytes"),
        ("images.npy", b"", ""),
        ("images.npy", b"\x93NUMPY\x01\x00", "cannot be read"),
        ("images.npy", b"\x93NUMPY\x01\x00\x0c\x00{'descr': (((", "cannot be read"),
        ("images.npy", HUGE, "Unable to allocate"),
    ],
    ids=["no array", "empty", "half a header", "broken header", "beyond the memory"],
)
def test_member_that_is_not_an_array_is_named(tmp_path: Path, member: str, content: bytes, got: str) -> None:
    """An error of NumPy or of the zip file never reaches the user."""
    source = save_arrays(tmp_path / "set.npz", images=None)
    with zipfile.ZipFile(source.root, "a") as file:
        file.writestr(member, content)
    with refused(DataError, place="set.npz, images", got=got):
        source.catalogue()
