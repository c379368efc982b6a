"""Splits are complete and disjoint, follow their seed, tear no group apart, and leave no class out unsaid."""

import hashlib

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from tacevo.data.splitting import TENTHS, check_balance, ordered_split, random_split
from tacevo.errors import DataError
from tacevo.parts.source import Split


def sizes(parts: Split) -> tuple[int, int, int]:
    """Count the rows of each part."""
    return len(parts.train), len(parts.validation), len(parts.test)


def assert_sound(parts: Split, count: int) -> None:
    """Hold a split to what every split promises."""
    together = np.concatenate([parts.train, parts.validation, parts.test])
    assert sorted(together) == list(range(count))
    assert all((np.diff(part) > 0).all() for part in (parts.train, parts.validation, parts.test))


@given(count=st.integers(10, 2_000), seed=st.integers(0, 2**32), classes=st.integers(1, 5))
def test_split_is_complete_disjoint_ascending_and_even(count: int, seed: int, classes: int) -> None:
    """Every row is in exactly one part, each part is in file order, and holds each class in proportion."""
    rows = np.arange(count) % classes
    parts = random_split(count, seed, classes=rows)
    assert_sound(parts, count)
    for part in (parts.train, parts.validation, parts.test):
        counts = np.bincount(rows[part], minlength=classes)
        assert counts.max() - counts.min() <= 2


@given(counts=st.lists(st.integers(1, 300), min_size=2, max_size=5), seed=st.integers(0, 2**32))
def test_part_holds_each_class_in_proportion(counts: list[int], seed: int) -> None:
    """However unequal the classes are: a stretch of the order has each within half a row and half of their number."""
    if sum(counts) < 10:
        return
    rows = np.repeat(np.arange(len(counts)), counts)
    parts = random_split(len(rows), seed, classes=rows)
    assert_sound(parts, len(rows))
    for part in (parts.train, parts.validation, parts.test):
        expected = np.array(counts) * len(part) / len(rows)
        assert np.abs(np.bincount(rows[part], minlength=len(counts)) - expected).max() <= 1 + len(counts)


@pytest.mark.parametrize(
    ("count", "held_out", "expected"),
    [
        (10, TENTHS, (8, 1, 1)),
        (14, TENTHS, (12, 1, 1)),
        (3_507, TENTHS, (2_805, 351, 351)),
        (15, (0.1, 0.3), (8, 2, 5)),
        (1_000, (0.29, 0.001), (709, 290, 1)),
    ],
)
def test_parts_have_the_sizes_that_were_asked(
    count: int, held_out: tuple[float, float], expected: tuple[int, int, int]
) -> None:
    """The paper's 3,507 gratings leave 351 test images; halves are rounded up, as written: 0.1 of 15 are two."""
    parts = random_split(count, 0, held_out=held_out)
    assert sizes(parts) == expected
    assert_sound(parts, count)


@pytest.mark.parametrize("held_out", [(0.001, 0.1), (0.1, 0.001), (0.5, 0.499)])
def test_part_without_an_image_is_refused(held_out: tuple[float, float]) -> None:
    """Whatever part is empty, for training too."""
    with refused(DataError, expected="at least one image each", got="of 100", remedy="data.validation_part"):
        random_split(100, 0, held_out=held_out)


def test_split_follows_its_seed() -> None:
    """One seed gives one split, another seed another."""
    assert np.array_equal(random_split(100, 1).test, random_split(100, 1).test)
    assert not np.array_equal(random_split(100, 1).test, random_split(100, 2).test)


def test_split_of_ungrouped_rows_is_pinned() -> None:
    """Published runs rest on these very rows."""
    parts = random_split(3_000, 0)
    digest = hashlib.sha256(b"".join(part.tobytes() for part in (parts.train, parts.validation, parts.test)))
    assert digest.hexdigest()[:16] == "6788b17e3c1f8e7f"


@given(data=st.data(), seed=st.integers(0, 2**32))
def test_no_group_is_torn(data: st.DataObject, seed: int) -> None:
    """Groups of any sizes in any order stay whole, and no part is empty."""
    groups = np.array(data.draw(st.lists(st.integers(-3, 12), min_size=10, max_size=200)))
    if len(np.unique(groups)) < 3:
        return
    parts = random_split(len(groups), seed, groups=groups)
    assert_sound(parts, len(groups))
    assert min(sizes(parts)) > 0
    held = [set(groups[part].tolist()) for part in (parts.train, parts.validation, parts.test)]
    assert sum(map(len, held)) == len(set().union(*held))


def presses(classes: int, groups: int, frames: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Number the presses and classes of a regular recording, class by class."""
    rows = np.arange(classes * groups * frames)
    return rows // frames, rows // (frames * groups)


@pytest.mark.parametrize("seed", range(5))
def test_grouped_parts_are_as_near_to_the_tenths_as_groups_allow(seed: int) -> None:
    """Seven sizes of 25 presses of 4 frames: 700 rows, so 560, and 68 or 72 for each of the others."""
    groups, classes = presses(7, 25, 4)
    parts = random_split(700, seed, groups=groups, classes=classes)
    assert sizes(parts) == (560, 68, 72)
    for part in (parts.validation, parts.test):
        assert np.bincount(classes[part], minlength=7).min() >= 8  # two whole presses of each size


def test_last_part_may_take_two_of_four_groups() -> None:
    """Each part has a group at least, and the last as many as come nearest."""
    groups = np.repeat(np.arange(4), (60, 24, 8, 8))
    assert sizes(random_split(100, 0, held_out=(0.24, 0.16), groups=groups, tries=99)) == (60, 24, 16)


def test_only_what_groups_share_matters() -> None:
    """Not their numbers within their order, nor that they are there where no two rows share one."""
    groups, _ = presses(1, 12, 3)
    assert np.array_equal(random_split(36, 0, groups=groups).test, random_split(36, 0, groups=groups * 100 - 7).test)
    classes = np.arange(200) % 4
    alone, plain = random_split(200, 3, groups=-np.arange(200), classes=classes), random_split(200, 3, classes=classes)
    assert np.array_equal(alone.train, plain.train)
    assert np.array_equal(alone.test, plain.test)


@pytest.mark.parametrize("seed", range(3))
def test_every_class_is_in_every_part_however_groups_are_numbered(seed: int) -> None:
    """Twelve presses of each of three classes, numbered without regard to their class."""
    groups, classes = presses(3, 12, 3)
    numbers = np.random.Generator(np.random.Philox(0)).permutation(36)
    parts = random_split(108, seed, groups=numbers[groups], classes=classes)
    for part in (parts.train, parts.validation, parts.test):
        assert np.bincount(classes[part], minlength=3).min() > 0


def test_ordered_split_takes_60_20_20() -> None:
    """The release rounds both boundaries; 25 presses give 15, 5 and 5 in their order."""
    parts = ordered_split(np.arange(25))
    assert (parts.train.tolist(), parts.validation.tolist()) == (list(range(15)), list(range(15, 20)))
    assert sizes(ordered_split(np.arange(11))) == (7, 2, 2)
    assert ordered_split(np.array([9, 8, 7, 6, 5])).test.tolist() == [5]


@pytest.mark.parametrize("part", ["train", "validation", "test"])
def test_class_that_a_part_lacks_is_named(part: str) -> None:
    """A class must be learnt, chosen by and measured; the message names part and class."""
    parts = {"train": [0, 1], "validation": [2, 3], "test": [4, 5]}
    rows = {name: np.array(numbers) for name, numbers in parts.items()}
    classes = np.array([0, 1, 0, 1, 0, 1])
    check_balance(Split(**rows), classes, ("wood", "felt"))
    classes[parts[part][1]] = 0
    with refused(DataError, place=f"the {part} split", got="no images of 1 of 2 classes (felt)"):
        check_balance(Split(**rows), classes, ("wood", "felt"))
