"""The protocol: statistics of the training split only, by exact arithmetic."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from tacevo.choices import Normalisation, TargetScaling
from tacevo.data.scaling import input_statistics, target_scale
from tacevo.errors import DataError

EVERY_ROW = np.arange(4)
LABELS = np.array([[1.0, -2.0], [3.0, 2.0], [5.0, 0.0], [7.0, 0.0]])


@given(seed=st.integers(0, 1_000))
def test_input_statistics_agree_with_numpy(seed: int) -> None:
    """The exact sums give what float64 gives, per channel and over the chosen rows only."""
    images = np.random.Generator(np.random.Philox(seed)).integers(0, 256, (70, 3, 2, 2)).astype(np.uint8)
    rows = np.arange(3, 69)
    mean, deviation = input_statistics(images, rows, Normalisation.standardise)
    assert mean == pytest.approx(images[rows].mean(axis=(0, 2, 3)))
    assert deviation == pytest.approx(images[rows].std(axis=(0, 2, 3)))


def test_constant_channel_and_unit_are_divided_by_what_they_can() -> None:
    """A channel that never changes has deviation 1; `unit` looks at no pixel."""
    images = np.full((4, 1, 2, 2), 7, dtype=np.uint8)
    assert input_statistics(images, EVERY_ROW, Normalisation.standardise) == ((7.0,), (1.0,))
    assert input_statistics(images, EVERY_ROW, Normalisation.unit) == ((0.0,), (255.0,))


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


def test_constant_target_is_refused_by_name() -> None:
    """A target with one value can be neither scaled nor learnt."""
    labels = np.column_stack([LABELS[:, 0], np.ones(4)])
    with refused(DataError, place="label fz", got="one value in the whole training split"):
        target_scale(labels, EVERY_ROW, TargetScaling.minmax, ("fx", "fz"))


@pytest.mark.parametrize("scaling", TargetScaling)
def test_target_scale_is_blind_to_every_other_row(scaling: TargetScaling) -> None:
    """Rows outside the training split may hold anything, even NaN."""
    train = np.array([0, 2, 3])
    spoilt = LABELS.copy()
    spoilt[1] = (np.nan, np.inf)
    names = ("a", "b")
    assert target_scale(spoilt, train, scaling, names) == target_scale(LABELS, train, scaling, names)


def test_zscore_squares_are_products() -> None:
    """With squares by a mathematics library's power this deviation was seen to end in 553, one bit further."""
    column = np.array([[0.0], [6.281], [8.04]])
    _, scale = target_scale(column, np.arange(3), TargetScaling.zscore, ("a",))
    assert scale == (3.4510327278785526,)


def test_zscore_sums_are_exact() -> None:
    """Ten tenths beside a huge value and its opposite: a plain sum loses them, in every order of the rows."""
    column = np.array([0.1] * 10 + [1e16, -1e16])
    for order in (np.arange(12), np.arange(12)[::-1], np.roll(np.arange(12), 5)):
        offset, _ = target_scale(column[order, None], np.arange(12), TargetScaling.zscore, ("a",))
        assert offset == (1.0 / 12,)
