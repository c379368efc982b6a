"""Promise: the smallest detectable effect is Noether's, and simulated studies detect it about as often as said."""

import numpy as np
import pytest

from analysis.statistics.power import Detectable, detectable
from analysis.statistics.tests import mann_whitney


def found(seeds: int, alpha: float) -> Detectable:
    """Return an effect that exists."""
    effect = detectable(seeds, alpha=alpha)
    assert effect is not None
    return effect


def test_twenty_seeds_by_hand() -> None:
    """(1.95996 + 0.84162) / sqrt(6 x 20) is 0.25575, and 0.69270 is the normal quantile of 0.75575."""
    effect = found(20, 0.05)
    assert effect.a12 == pytest.approx(0.75575, abs=1e-5)
    assert effect.shift == pytest.approx(np.sqrt(2) * 0.6927, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.05, 0.0125])
def test_simulated_studies_detect_it_as_often_as_said_or_somewhat_oftener(alpha: float) -> None:
    """A thousand normal studies of 20 seeds, at both levels of Holm's four."""
    draw, effect = np.random.default_rng(0), found(20, alpha)
    detected = sum(
        mann_whitney(draw.normal(effect.shift, size=20), draw.normal(size=20)).p <= alpha for _ in range(1000)
    )
    assert 0.78 <= detected / 1000 <= 0.9


@pytest.mark.parametrize("seeds", [4, 5])
def test_no_answer_is_not_no_effect(seeds: int) -> None:
    """The formula gives none for so few seeds; three standard deviations are often detected still."""
    assert detectable(seeds, alpha=0.05) is None
    draw = np.random.default_rng(0)
    detected = sum(mann_whitney(draw.normal(3, size=seeds), draw.normal(size=seeds)).p <= 0.05 for _ in range(500))
    assert detected / 500 > 0.75


@pytest.mark.parametrize(("seeds", "alpha", "power"), [(1, 0.05, 0.8), (20, 0.0, 0.8), (20, 1.0, 0.8), (20, 0.05, 1.0)])
def test_arguments_out_of_range_are_refused(seeds: int, alpha: float, power: float) -> None:
    """Levels and powers are open intervals: at their ends the answer is infinite."""
    with pytest.raises(ValueError, match="power needs seeds >= 2, alpha and power in"):
        detectable(seeds, alpha=alpha, power=power)
