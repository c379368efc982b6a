"""Promise: the effect that a study of so many seeds detects is that of the formula, and of simulated studies."""

import numpy as np
import pytest

from analysis.statistics.tests import detectable, mann_whitney


def test_detectable_effect_by_hand() -> None:
    """(1.95996 + 0.84162) / sqrt(6 x 20) is 0.25575, and 0.69270 is the normal quantile of 0.75575."""
    assert detectable(20, 20, alpha=0.05) == pytest.approx((0.75575, np.sqrt(2) * 0.6927), abs=1e-4)
    assert detectable(15, 30, alpha=0.05) == detectable(20, 20, alpha=0.05)  # the harmonic mean counts


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.05, 0.0125])
def test_simulated_studies_detect_it_as_often_as_said_or_somewhat_oftener(alpha: float) -> None:
    """A thousand normal studies of 20 seeds, at both levels of Holm's four."""
    draw, effect = np.random.default_rng(0), detectable(20, 20, alpha=alpha)
    assert effect is not None
    detected = sum(mann_whitney(draw.normal(effect[1], size=20), draw.normal(size=20)).p <= alpha for _ in range(1000))
    assert 0.78 <= detected / 1000 <= 0.9


@pytest.mark.parametrize("seeds", [4, 5])
def test_no_answer_is_not_no_effect(seeds: int) -> None:
    """The formula gives none for so few seeds; three standard deviations are often detected still."""
    assert detectable(seeds, seeds, alpha=0.05) is None
    draw = np.random.default_rng(0)
    detected = sum(mann_whitney(draw.normal(3, size=seeds), draw.normal(size=seeds)).p <= 0.05 for _ in range(500))
    assert detected / 500 > 0.75
