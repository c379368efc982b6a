"""Promise: a pilot says whether a space can tell networks apart, and luck does not make it look better."""

import json

import numpy as np
import pandas as pd
import pytest
from checkout import ROOT

from benchmarks import pilot
from benchmarks.pilot import Pilot, best_quarter, drawn, gained, near, pilot_of, reliability, rows, shrunken, strongest

pytestmark = pytest.mark.room("table")


def _made_up(networks: int, effect: float, noise: float) -> Pilot:
    """Make networks up whose log losses are a sum of two genes and the noise of a seed; a third gene does nothing."""
    rng = np.random.default_rng(0)
    genes = pd.DataFrame({name: rng.integers(3, size=networks) for name in ("a", "b", "c")})
    level = effect * (genes["a"] + genes["b"]).to_numpy()
    tests = level[:, None] + noise * rng.standard_normal((networks, 2))
    fitness = np.exp(level[:, None] + noise * rng.standard_normal((networks, 2)))
    return Pilot(genes, tests, fitness, late=0.0)


def test_two_genes_that_matter_are_named() -> None:
    """They explain all where no seed has noise, and about nothing where noise is all."""
    explained, names = strongest(_made_up(200, 1.0, 0.0))
    assert (round(explained, 6), names) == (1.0, "a and b")
    assert strongest(_made_up(200, 0.0, 1.0))[0] < 0.1


def test_luck_brings_nobody_into_the_best_quarter() -> None:
    """A network whose genes are the worst stays out of it, however low its own losses are."""
    plain = _made_up(200, 1.0, 0.1)
    worst = int((plain.genes["a"] + plain.genes["b"]).argmax())
    plain.tests[worst] = -5.0
    assert worst not in best_quarter(plain)
    assert set(plain.genes.loc[best_quarter(plain), "a"]) < {0, 1, 2}


def test_noise_alone_gains_nothing() -> None:
    """One seed chooses and the other judges; where networks differ, more draws hand over a better one."""
    noise, real = _made_up(200, 0.0, 1.0), _made_up(200, 1.0, 0.1)
    assert abs(gained(noise, 1, 100)) < 0.5
    assert gained(real, 1, 100) > 0.8
    assert reliability(noise.tests) < 0.4
    assert reliability(real.tests) > 0.98


def test_mean_of_noise_is_moved_to_the_middle() -> None:
    """By hand: two seeds that agree on nothing leave no difference between networks, and two that agree leave all."""
    agree, differ = np.array([[0.0, 0.0], [1.0, 1.0]]), np.array([[0.0, 1.0], [1.0, 0.0]])
    assert shrunken(agree) == pytest.approx([0, 1])
    assert shrunken(differ) == pytest.approx([0.5, 0.5])
    assert [near(tests) for tests in (agree, differ)] == [1, 2]


def test_larger_pilot_holds_the_smaller() -> None:
    """So more networks can be trained later; none comes twice."""
    few, many = drawn(10), drawn(200)
    assert many[:10] == few
    assert len({json.dumps(one) for one in many}) == 200


def test_failed_network_is_left_out() -> None:
    """It has no loss under one of the seeds."""
    genomes = [{"a": number, "b": 0} for number in range(3)]
    losses = {kind: [[0.5, 0.5], [0.5, None], [0.4, 0.4]] for kind in ("test", "fitness", "best_epoch")}
    found = pilot_of({"epochs": 20, "genomes": genomes, **losses})
    assert found.genes.to_dict("list") == {"a": [0, 2]}  # a gene that does not vary says nothing
    assert found.tests.shape == (2, 2)


def test_page_shows_the_pilots() -> None:
    """Every row is computed from results/pilots.json."""
    recorded = json.loads(pilot.RESULTS.read_text(encoding="utf-8"))
    assert "\n".join(rows(recorded)) in (ROOT / "benchmarks/README.md").read_text(encoding="utf-8")
