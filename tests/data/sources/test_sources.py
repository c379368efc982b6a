"""Promise of every source: what was written is read, to the bit and in order; or it is refused, and nothing is lost."""

import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of
from refusals import refused
from small_recordings import in_rooms, save_arrays, save_folder, save_forces, save_gratings, save_image, save_table

from tacevo.choices import SplitRule
from tacevo.data.loading import split_rows
from tacevo.data.sources.image_files import to_8_bits
from tacevo.errors import DataError
from tacevo.parts.source import Catalogue, Source

forty = settings(max_examples=40, deadline=None)

FINITE = st.floats(allow_nan=False, allow_infinity=False)


@contextmanager
def somewhere() -> Iterator[Path]:
    """Offer a directory for one example."""
    with tempfile.TemporaryDirectory() as directory:
        yield Path(directory)


def reds(catalogue: Catalogue) -> list[int]:
    """Decode every picture to its red, which tells which file it was."""
    return [int(picture()[0, 0, 0]) for picture in catalogue.pictures]


def listed(source: Source) -> Catalogue | None:
    """List a source; None where it is refused, in an error that says what is wrong and where or what to do."""
    try:
        catalogue = source.catalogue()
    except DataError as error:
        refusal = error
    else:
        assert len(catalogue.pictures) == len(catalogue.labels) == len(catalogue.extents)
        return catalogue
    assert refusal.got
    assert refusal.place or refusal.remedy
    assert len(str(refusal)) < 1_000
    return None


@forty
@given(st.lists(st.tuples(st.integers(0, 5), FINITE, FINITE), min_size=1, max_size=6, unique_by=lambda row: row[0]))
def test_labels_of_a_table_keep_every_bit_and_rows_their_order(rows: list[tuple[int, float, float]]) -> None:
    """As Python writes floats; columns come in the order that was asked for. Images that no row names are told."""
    with somewhere() as root:
        source = save_table(root, "".join(f" {number}.png, {fx!r} ,{fz!r},x\n" for number, fx, fz in rows), images=6)
        catalogue = source.catalogue()
        assert catalogue.labels.tolist() == [[fz, fx] for _, fx, fz in rows]
        assert reds(catalogue) == [number for number, *_ in rows]
        used = [path.name for path in (*(catalogue.files or ()), *catalogue.ignored)]
        assert sorted(used) == [f"{number}.png" for number in range(6)]


NAMES = st.sampled_from(["0.png", "1.png", "2.png", "./0.png", "0.PNG", "9.png", "1", "", "\0", "x" * 300])
VALUES = st.sampled_from(["1", "-.5", "+1.", "1e-3", "nan", "1,5", "1_000", '"', '"2"', " ", ";"]) | st.text(max_size=4)
LINE = st.builds(lambda name, values: ",".join([name, *values]), NAMES, st.lists(VALUES, min_size=1, max_size=4))


@forty
@given(st.lists(LINE, max_size=5), st.booleans())
def test_any_table_is_read_whole_or_refused(lines: list[str], skip_missing: bool) -> None:
    """Whatever stands in its lines, none of them disappears."""
    with somewhere() as root:
        text = "\n".join(lines)
        catalogue = listed(replace(save_table(root, text), skip_missing=skip_missing))
    if catalogue is not None:
        written = len([line for line in re.split("\r\n|\r|\n", text) if line])
        assert len(catalogue.labels) + catalogue.skipped + len(catalogue.blank) == written
        assert np.isfinite(catalogue.labels).all()
        assert skip_missing or catalogue.skipped == 0


CLASSES = st.sampled_from(["a", "A", "b", "2", "10", "0.5", "0.50", "nan", "1_0", ".a", "__MACOSX"])
FILES = st.sampled_from(["1.png", "1.PNG", "2.jpeg", "deep/3.TIF", "notes.txt", ".4.png", ".ipynb_checkpoints/1.png"])


@forty
@given(st.lists(st.tuples(CLASSES, FILES), max_size=8, unique=True))
def test_any_directory_of_classes_is_read_whole_or_refused(files: list[tuple[str, str]]) -> None:
    """Every file that is not hidden is an image of its class or told as ignored; numbers are in their order."""
    with somewhere() as root:
        source = save_folder(root, *("/".join(parts) for parts in files if not parts[1].endswith(".txt")))
        for directory, name in files:
            (root / directory).mkdir(exist_ok=True)
            (root / directory / name).touch()
        catalogue = listed(source)
        if catalogue is None:
            return
        visible = {
            root / directory / name for directory, name in files if directory[0] not in "._" and "." not in name[0]
        }
        assert {*(catalogue.files or ()), *catalogue.ignored} == visible
        for path, label in zip(catalogue.files or (), catalogue.labels, strict=True):
            assert path.relative_to(root).parts[0] == catalogue.names[int(label)]
    numbers = all(re.fullmatch(r"[\d.]+", name) for name in catalogue.names)
    keys: list[Any] = [float(name) if numbers else name for name in catalogue.names]
    assert all(one < other for one, other in pairwise(keys))


NUMBERS = st.sampled_from(["?", "i1", "u1", ">i4", "i8", "f2", ">f4", "f8", "g", "c8", "U2", "S2", "M8[s]"])
SHAPES = st.sampled_from([(12,), (12, 1), (12, 2), (12, 0), (11,), (), (12, 2, 2)])


@forty
@given(st.data(), NUMBERS, SHAPES)
def test_any_labels_of_an_archive_are_read_or_refused(data: st.DataObject, number: str, shape: tuple[int, ...]) -> None:
    """What is read are the very values, as 64 bits."""
    labels = data.draw(arrays_of.arrays(number, shape) | st.just(np.resize(np.arange(3), shape).astype(number)))
    with somewhere() as root:
        catalogue = listed(save_arrays(root / "a.npz", labels=labels))
    if catalogue is not None:
        assert catalogue.labels.dtype in (np.int64, np.float64)
        assert (catalogue.labels.reshape(shape) == labels).all()


IMAGES = st.tuples(st.sampled_from([11, 12]), st.integers(0, 9), st.integers(1, 9), st.sampled_from([0, 1, 2, 3, 4]))


@forty
@given(NUMBERS, IMAGES, st.booleans(), st.sampled_from([None, 255.0, 4095.0]))
def test_any_images_of_an_archive_are_read_or_refused(
    number: str, shape: tuple[int, ...], flat: bool, white: float | None
) -> None:
    """Grey and colour with any height and width; the catalogue tells the size."""
    images = np.ones(shape[:3] if flat else shape).astype(number)
    with somewhere() as root:
        catalogue = listed(replace(save_arrays(root / "a.npz", images=images), white_point=white))
    if catalogue is not None:
        assert catalogue.recorded_size == (shape[2], shape[1])
        expected = round(255 / (white or 255))
        assert (catalogue.pictures[11]() == np.full((3, 16, 16), expected)).all()


@forty
@given(st.integers(0, 2_000))
def test_archive_that_is_cut_off_is_refused(length: int) -> None:
    """Wherever it ends."""
    with somewhere() as root:
        source = save_arrays(root / "a.npz")
        content = source.root.read_bytes()
        source.root.write_bytes(content[:length])
        assert (listed(source) is None) == (length < len(content))


@pytest.mark.room("tacverse")
@forty
@given(st.lists(st.integers(0, 10_000), min_size=10, max_size=15, unique=True))
def test_forces_of_the_release_are_in_the_order_of_their_numbers(numbers: list[int]) -> None:
    """For every order of the rows; so many in a hundred train, validate and test."""
    with somewhere() as root:
        source = save_forces(
            root, "".join(f"image_{number}.png,{number},1,{-number}\n" for number in numbers), images=0
        )
        for number in numbers:
            save_image(root / "Force_Regression" / "ViTacTip" / f"image_{number}.png", number % 256)
        catalogue = source.catalogue()
        assert catalogue.labels[:, 0].tolist() == sorted(numbers)
        assert reds(catalogue) == [number % 256 for number in sorted(numbers)]
    parts, count = split_rows(catalogue, SplitRule.release, 0), len(numbers)
    ends = round(0.6 * count), round(0.8 * count)
    assert [part.tolist() for part in (parts.train, parts.validation, parts.test)] == [
        list(range(*ends_of)) for ends_of in ((ends[0],), ends, (ends[1], count))
    ]


PRESSES = st.dictionaries(st.integers(1, 40), st.integers(1, 2), min_size=5, max_size=8)


@pytest.mark.room("tacverse")
@forty
@given(PRESSES, PRESSES)
def test_presses_of_the_release_are_whole_and_in_the_order_of_their_numbers(
    fine: dict[int, int], coarse: dict[int, int]
) -> None:
    """As sizes and frames are; each size's presses are cut at 60 and 80 in a hundred of their own number."""
    presses = [(size, press) for size, frames in ((0.5, fine), (10.0, coarse)) for press in frames]
    names = [(size, press, frame) for size, press in presses for frame in range({0.5: fine, 10.0: coarse}[size][press])]
    with somewhere() as root:
        catalogue = save_gratings(root, *(f"{size:g}_{press}_{frame}.png" for size, press, frame in names)).catalogue()
    assert catalogue.names == ("0.5 mm", "10 mm")
    assert [path.stem for path in catalogue.files or ()] == [
        f"{size:g}_{p}_{frame}" for size, p, frame in sorted(names)
    ]
    read = [name[:2] for name in sorted(names)]
    assert catalogue.groups is not None
    assert catalogue.groups.tolist() == [sorted(presses).index(press) for press in read]
    parts = split_rows(catalogue, SplitRule.release, 0)
    held = [{read[row] for row in part} for part in (parts.train, parts.validation, parts.test)]
    for size, frames in ((0.5, fine), (10.0, coarse)):
        own, ends = sorted((size, press) for press in frames), (round(0.6 * len(frames)), round(0.8 * len(frames)))
        assert [{press for press in part if press[0] == size} for part in held] == [
            {*own[: ends[0]]},
            {*own[ends[0] : ends[1]]},
            {*own[ends[1] :]},
        ]


@forty
@given(st.integers(1, 65_535), st.data())
def test_white_becomes_255_and_all_else_is_rounded_to_the_nearest(white: int, data: st.DataObject) -> None:
    """Halves go up; values beyond the white, or below 0, are refused."""
    values = data.draw(arrays_of.arrays(np.int64, 8, elements=st.integers(0, white)))
    scaled = to_8_bits(values, float(white))
    assert (np.abs(scaled - values * 255 / white) <= 0.5).all()
    assert to_8_bits(np.array([white]), float(white)) == 255
    for beyond in (-1, white + 1):
        with refused(DataError, got=f"beyond data.white_point={white:g}"):
            to_8_bits(np.append(values, beyond), float(white))


#: One source of each form; each takes the directory that it may fill.
FORMS: dict[str, Callable[[Path], Any]] = {
    "table": lambda root: save_table(root, "0.png,1,2,\n1.png,3,4,\n"),
    "folder": lambda root: save_folder(root, "a/1.png", "b/1.png"),
    "archive": lambda root: save_arrays(root / "a.npz"),
    "forces": lambda root: save_forces(root, "image_0.png,1,2,3\nimage_1.png,4,5,6\n"),
    "gratings": lambda root: save_gratings(root, "1_1.png", "3_1.png"),
}


@pytest.mark.parametrize("form", in_rooms(FORMS))
def test_description_follows_content_and_not_place(tmp_path: Path, form: str) -> None:
    """A copy elsewhere is the same data set; with one other byte in any file that is read it is another."""
    source = FORMS[form](tmp_path / "here")
    described = source.describe()
    assert FORMS[form](tmp_path / "there").describe() == described
    files = [
        path for path in (tmp_path / "here").rglob("*") if path.is_file() and path.name not in ("2.png", "image_2.png")
    ]
    for number, file in enumerate(files):
        there = shutil.copytree(tmp_path / "here", tmp_path / str(number))
        changed = there / file.relative_to(tmp_path / "here")
        content = changed.read_bytes()
        changed.write_bytes(content.replace(b"2", b"7") if file.suffix == ".csv" else content[:-1] + b"x")
        root = there / "a.npz" if form == "archive" else there
        assert replace(source, root=root).describe() != described


@pytest.mark.parametrize("form", in_rooms(form for form in FORMS if form != "archive"))
def test_mixed_sizes_and_unreadable_images_are_named(tmp_path: Path, form: str) -> None:
    """Both are found from the headers, before anything is decoded."""
    source = FORMS[form](tmp_path)
    first, second, *_ = sorted(path for path in tmp_path.rglob("*.png"))
    save_image(second, 0, size=(9, 8))
    with refused(DataError, got="8x8 pixels (width x height), others not (1 found): ") as sizes:
        source.catalogue()
    assert f"{second.name}" in sizes.value.got
    second.write_text("no image")
    with refused(DataError, got="cannot be read (1 found): ", remedy="repair or remove") as text:
        source.catalogue()
    assert second.name in text.value.got
    assert first.name not in text.value.got.replace(second.name, "")
