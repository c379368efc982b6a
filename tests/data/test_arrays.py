"""NumPy archives: floats are values, whole numbers classes; nothing is unpickled, and every broken array is named."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_recordings import save_arrays

from tacevo.choices import SplitRule
from tacevo.data.loading import split_rows
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
    """Classes are called by their numbers where nobody names them."""
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


def test_groups_stay_together(tmp_path: Path) -> None:
    """What was recorded together is in one part of the split."""
    groups = np.arange(12) // 2
    catalogue = save_arrays(tmp_path / "set.npz", groups=groups).catalogue()
    parts = split_rows(catalogue, SplitRule.random, 0)
    assert not set(groups[parts.train]) & set(groups[parts.test])


def test_pixels_of_the_asked_size_are_unchanged(tmp_path: Path) -> None:
    """Channels come first; nothing else is done to them."""
    images = IMAGES[:, :, :6].repeat(2, axis=1)[:, :16].repeat(3, axis=2)[:, :, :16]
    pictures = save_arrays(tmp_path / "set.npz", images=images).catalogue().pictures
    assert np.array_equal(pictures[5](), images[5].transpose(2, 0, 1))


@pytest.mark.parametrize("shape", [(12, 16, 16), (12, 16, 16, 1)])
def test_grey_is_repeated(tmp_path: Path, shape: tuple[int, ...]) -> None:
    """With and without an axis of its own, grey becomes three equal channels."""
    images = np.arange(12 * 256, dtype=np.uint8).reshape(shape)
    picture = save_arrays(tmp_path / "set.npz", images=images).catalogue().pictures[3]()
    assert np.array_equal(picture, np.stack([images[3].reshape(16, 16)] * 3))


def test_images_are_resized_to_a_square(tmp_path: Path) -> None:
    """Size and aspect of the arrays are free; the catalogue tells them as width and height."""
    catalogue = save_arrays(tmp_path / "set.npz", images=IMAGES).catalogue()
    assert catalogue.pictures[0]().shape == (3, 16, 16)
    assert catalogue.recorded_size == (6, 8)


def test_description_follows_content_and_not_place(tmp_path: Path) -> None:
    """A copy elsewhere is the same data set; one other pixel makes another."""
    here, there = save_arrays(tmp_path / "a.npz", images=IMAGES), save_arrays(tmp_path / "b.npz", images=IMAGES)
    assert here.describe() == there.describe()
    changed = IMAGES.copy()
    changed[0, 0, 0, 0] ^= 1
    assert here.describe() != save_arrays(tmp_path / "c.npz", images=changed).describe()


NAN_ROWS = np.array([[0.0, 1.0], [np.nan, 1.0], [0.0, np.inf]] * 4)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"images": None}, r"lacks arrays \(1 found\): images. It has \['labels'\]"),
        ({"images": None, "labels": None, "names": np.array(["a"])}, r"lacks arrays \(2 found\): images, labels"),
        ({"group": np.arange(12)}, r"unknown arrays \(1 found\): group. Remove them; known are \['groups', 'images'"),
        ({"images": IMAGES.astype(np.uint16)}, r"images must be uint8 .*; got uint16 of shape \(12, 8, 6, 3\)"),
        ({"images": IMAGES / 255}, r"images must be uint8 .*; got float64"),
        ({"images": IMAGES.transpose(0, 3, 1, 2)}, r"images must be .*; got uint8 of shape \(12, 3, 8, 6\)"),
        ({"images": IMAGES[0, :, :, 0]}, r"images must be .*; got uint8 of shape \(8, 6\)"),
        ({"images": np.zeros((12, 0, 8), dtype=np.uint8)}, r"images is empty: it has shape \(12, 0, 8\); save at"),
        ({"images": IMAGES[:0], "labels": np.zeros(0)}, r"images is empty: it has shape \(0, 8, 6, 3\); save at"),
        ({"labels": np.zeros(11)}, r"labels must have one row for each of the 12 images; got shape \(11,\)"),
        ({"labels": np.float64(1)}, r"labels must have one row .*; got shape \(\)"),
        ({"labels": np.zeros((12, 2, 2))}, r"labels must be floats .*; got float64 of shape \(12, 2, 2\)"),
        ({"labels": np.zeros((12, 0))}, r"labels must be floats .*; got float64 of shape \(12, 0\)"),
        ({"labels": np.array(["a"] * 12)}, r"labels must be floats .*; got <U1"),
        ({"labels": np.zeros(12, dtype=bool)}, r"labels must be floats .*; got bool"),
        ({"labels": NAN_ROWS}, r"finite numbers \(8 found\): row 1 is \[nan, 1.0\], row 2 is \[0.0, inf\], row 4"),
        ({"labels": np.full(12, np.longdouble("1e4000"))}, r"finite numbers \(12 found\): row 0 is \[inf\]"),
        ({"labels": CLASSES.reshape(12, 1)}, r"labels of whole numbers are classes, .*; got \(12, 1\); save values as"),
        ({"labels": CLASSES - 1}, r"from 0 without a gap \(4 found\): row 0 is -1, row 3 is -1, row 6 is -1, row 9"),
        ({"labels": CLASSES * 2}, r"from 0 without a gap \(4 found\): row 2 is 4.*There are 3 classes"),
        ({"labels": CLASSES, "names": np.array(["a", "b"])}, r"\(4 found\): row 2 is 2.*There are 2 names"),
        ({"labels": CLASSES, "names": np.array(list("abcd"))}, r"some classes have no images \(1 found\): 3"),
        ({"labels": CLASSES, "names": np.array(["a", "b", "a"])}, r"names must be 3 different texts; got .*'a', 'b'"),
        ({"names": np.array([1.0])}, "names must be 1 different texts; got float64"),
        ({"names": np.array(["a", "b"])}, r"names must be 1 different texts; got <U1 of shape \(2,\)"),
        ({"groups": np.zeros(11, dtype=int)}, r"groups must have one row for each of the 12 images; got shape \(11,\)"),
        ({"groups": np.zeros(12)}, r"groups must be whole numbers of shape \(N,\); got float64"),
        ({"groups": np.zeros((12, 1), dtype=int)}, r"groups must be whole numbers of shape \(N,\); got int64 of"),
    ],
)
def test_broken_arrays_are_named(tmp_path: Path, arrays: dict[str, Any], message: str) -> None:
    """The message says which array, what it must be, and what it is."""
    with pytest.raises(DataError, match=message):
        save_arrays(tmp_path / "set.npz", **arrays).catalogue()


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    """An array of objects would run code when it is read."""
    objects = np.array([print] * 12, dtype=object)
    with pytest.raises(DataError, match=r"array 'labels' of .* is damaged, or holds Python objects; save numbers"):
        save_arrays(tmp_path / "set.npz", labels=objects).catalogue()


def test_pickle_in_place_of_an_archive_is_refused(tmp_path: Path) -> None:
    """Neither is a file that is a pickle as a whole."""
    path = tmp_path / "set.npz"
    path.write_bytes(b"\x80\x04N.")
    with pytest.raises(DataError, match="is no NumPy archive, or was cut off; save images and labels together"):
        Arrays(root=path, image_size=16).catalogue()


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04 and no more"])
def test_file_that_is_no_archive_is_refused(tmp_path: Path, content: bytes) -> None:
    """Empty, text, or the beginning of a zip file."""
    path = tmp_path / "set.npz"
    path.write_bytes(content)
    with pytest.raises(DataError, match="is no NumPy archive, or was cut off; save images and labels together"):
        Arrays(root=path, image_size=16).catalogue()


def test_damaged_archive_is_refused(tmp_path: Path) -> None:
    """A changed byte in the middle is noticed by the checksum of the archive."""
    source = save_arrays(tmp_path / "set.npz", images=IMAGES)
    content = bytearray(source.root.read_bytes())
    content[500] ^= 0xFF
    source.root.write_bytes(content)
    with pytest.raises(DataError, match=r"array 'images' of .* is damaged"):
        source.catalogue()


def test_single_array_is_refused(tmp_path: Path) -> None:
    """Images alone, as `numpy.save` writes them, have no labels."""
    np.save(tmp_path / "images.npy", IMAGES)
    with pytest.raises(DataError, match=r"holds one array; save images and labels together with numpy.savez"):
        Arrays(root=tmp_path / "images.npy", image_size=16).catalogue()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "sets.npz",
            r"data.root is no file: .*; give the .npz archive. .* it holds empty, set.npz; did you mean .*/set",
        ),
        (".", r"data.root is a folder, not a .npz archive: .*; it holds set.npz; set data.root=.*/set.npz$"),
        ("empty", r"data.root is a folder, not a .npz archive: .*; it holds none that can be seen$"),
    ],
)
def test_wrong_root_says_what_is_there(tmp_path: Path, name: str, message: str) -> None:
    """The archive is a file; where it was not found, those that are there are named."""
    save_arrays(tmp_path / "set.npz")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match=message):
        Arrays(root=tmp_path / name, image_size=16).describe()


def spoilt(path: Path, member: str, content: bytes) -> Arrays:
    """Write an archive with a sound array of labels, and a member of our own making."""
    labels = io.BytesIO()
    np.save(labels, np.linspace(0, 1, 12))
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("labels.npy", labels.getvalue())
        file.writestr(member, content)
    return Arrays(root=path, image_size=16)


@pytest.mark.parametrize(
    ("member", "content", "message"),
    [
        ("images", b"pixels", "'images' of .* is no array"),
        ("images.npy", b"", "'images' of .* is (damaged|no array)"),
        ("images.npy", b"\x93NUMPY\x01\x00", "array 'images' of .* is damaged"),
        ("images.npy", b"\x93NUMPY\x01\x00\x0c\x00{'descr': (((", "array 'images' of .* is damaged"),
        ("images.npy", HUGE, "array 'images' of .* needs more memory than there is"),
    ],
    ids=["no array", "empty", "half a header", "broken header", "beyond the memory"],
)
def test_member_that_is_no_array_is_named(tmp_path: Path, member: str, content: bytes, message: str) -> None:
    """Whatever stands in the place of an array, the message is ours."""
    with pytest.raises(DataError, match=message) as caught:
        spoilt(tmp_path / "set.npz", member, content).catalogue()
    assert "pickle" not in str(caught.value)
