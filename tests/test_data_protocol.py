"""The protocol: an 80/10/10 split by a seed, statistics of the training split only, exact arithmetic."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacevo.choices import Normalisation, TargetScaling
from tacevo.data.protocol import input_statistics, split, target_scale
from tacevo.errors import DataError

EVERY_ROW = np.arange(4)
LABELS = np.array([[1.0, -2.0], [3.0, 2.0], [5.0, 0.0], [7.0, 0.0]])


@given(count=st.integers(10, 5_000), seed=st.integers(0, 2**32))
def test_split_is_complete_disjoint_and_ascending(count: int, seed: int) -> None:
    """Every row is in exactly one part, and each part is in file order."""
    parts = split(count, seed)
    together = np.concatenate([parts.train, parts.validation, parts.test])
    assert sorted(together) == list(range(count))
    assert all((np.diff(part) > 0).all() for part in (parts.train, parts.validation, parts.test))


@pytest.mark.parametrize(
    ("count", "sizes"), [(10, (8, 1, 1)), (14, (12, 1, 1)), (3_000, (2_400, 300, 300)), (3_507, (2_805, 351, 351))]
)
def test_parts_have_the_sizes_of_the_paper(count: int, sizes: tuple[int, int, int]) -> None:
    """The paper's 3,507 gratings leave 351 test images, as its 350 of 351 correct answers say."""
    parts = split(count, seed=0)
    assert (len(parts.train), len(parts.validation), len(parts.test)) == sizes


def test_split_follows_its_seed() -> None:
    """One seed gives one split, another seed another."""
    assert np.array_equal(split(100, 1).test, split(100, 1).test)
    assert not np.array_equal(split(100, 1).test, split(100, 2).test)


def test_input_statistics_of_a_hand_computed_image() -> None:
    """Values 0, 0, 10, 30 have mean 10 and population deviation sqrt(150)."""
    images = np.array([[[[0, 0], [10, 30]]]], dtype=np.uint8)
    assert input_statistics(images, np.array([0]), Normalisation.standardise) == ((10.0,), (150**0.5,))


@given(seed=st.integers(0, 1_000))
def test_input_statistics_agree_with_numpy(seed: int) -> None:
    """The exact sums give what float64 gives, per channel and over the chosen rows only."""
    images = np.random.Generator(np.random.Philox(seed)).integers(0, 256, (70, 3, 2, 2)).astype(np.uint8)
    rows = np.arange(3, 69)
    mean, deviation = input_statistics(images, rows, Normalisation.standardise)
    assert mean == pytest.approx(images[rows].mean(axis=(0, 2, 3)))
    assert deviation == pytest.approx(images[rows].std(axis=(0, 2, 3)))


def test_constant_channel_has_deviation_one() -> None:
    """A channel that never changes can be divided by its deviation."""
    images = np.full((4, 1, 2, 2), 7, dtype=np.uint8)
    assert input_statistics(images, EVERY_ROW, Normalisation.standardise) == ((7.0,), (1.0,))


def test_unit_normalisation_divides_by_255() -> None:
    """`unit` looks at no pixel."""
    images = np.full((4, 3, 2, 2), 7, dtype=np.uint8)
    assert input_statistics(images, EVERY_ROW, Normalisation.unit) == ((0.0,) * 3, (255.0,) * 3)


@pytest.mark.parametrize(
    ("scaling", "offset", "scale"),
    [
        (TargetScaling.minmax, (1.0, -2.0), (6.0, 4.0)),
        (TargetScaling.zscore, (4.0, 0.0), (5**0.5, 2**0.5)),
        (TargetScaling.none, (0.0, 0.0), (1.0, 1.0)),
    ],
)
def test_target_scales_computed_by_hand(
    scaling: TargetScaling, offset: tuple[float, float], scale: tuple[float, float]
) -> None:
    """Range, mean and population deviation of two small columns."""
    assert target_scale(LABELS, EVERY_ROW, scaling, ("a", "b")) == (offset, scale)


def test_target_scale_uses_the_given_rows_only() -> None:
    """A row outside the training split does not widen the range."""
    offset, scale = target_scale(LABELS, np.array([0, 1]), TargetScaling.minmax, ("a", "b"))
    assert (offset, scale) == ((1.0, -2.0), (2.0, 4.0))


def test_constant_target_is_refused_by_name() -> None:
    """A target with one value can be neither scaled nor learnt."""
    labels = np.column_stack([LABELS[:, 0], np.ones(4)])
    with pytest.raises(DataError, match=r"target \['fz'\] has one value"):
        target_scale(labels, EVERY_ROW, TargetScaling.minmax, ("fx", "fz"))
