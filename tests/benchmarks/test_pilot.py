"""Promise: a pilot says whether a space can tell networks apart, and luck does not make it look better."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from checkout import ROOT

from benchmarks.pilot import (
    GENES,
    Pilot,
    best_quarter,
    drawn,
    gained,
    largest,
    near,
    pilot_of,
    recorded,
    strongest,
    table_lines,
    with_bootstrap,
    with_noise,
)
from tacevo.config.compose import compose
from tacevo.runs.datasets import load_data
from tacevo.runs.progress import Progress

pytestmark = pytest.mark.room("table", "noise", "surrogate", "grammar")


def _made_up(networks: int, effect: float, noise: float) -> Pilot:
    """Make networks up whose log losses are a sum of two genes and the noise of a seed; a third gene does nothing.

    Of one training the fitness is the test loss, so that luck would look like a gain if the seed that chose judged.
    """
    rng = np.random.default_rng(0)
    genes = pd.DataFrame({name: rng.integers(3, size=networks) for name in ("a", "b", "c")})
    level = effect * (genes["a"] + genes["b"]).to_numpy()
    tests = level[:, None] + noise * rng.standard_normal((networks, 2))
    return Pilot(genes, [{}] * networks, tests, np.exp(tests), late=0.0)


def test_two_genes_that_matter_are_named() -> None:
    """They explain all where seeds have no noise, and next to nothing where noise is all."""
    explained, names = strongest(_made_up(400, 1.0, 0.0))
    assert explained == pytest.approx(1.0)
    assert names == "a and b"
    assert strongest(_made_up(400, 0.0, 1.0))[0] < 0.1


def test_luck_brings_nobody_into_the_best_quarter() -> None:
    """A network whose genes are the worst stays out of it, however low its own losses are."""
    plain = _made_up(200, 1.0, 0.1)
    worst = int((plain.genes["a"] + plain.genes["b"]).argmax())
    plain.tests[worst] = -5.0
    assert worst not in best_quarter(plain)


def test_noise_alone_gains_nothing() -> None:
    """The seed that chose does not judge; where networks differ, more draws hand over a better one."""
    gain, low, high = with_bootstrap(_made_up(400, 0.0, 1.0), gained)
    assert low < 0 < high
    assert abs(gain) < 0.1
    gain, low, _ = with_bootstrap(_made_up(400, 1.0, 0.1), gained)
    assert gain > low > 0.3


def test_gain_is_that_of_normal_values() -> None:
    """By hand: without noise it is the deviation of networks times how much farther the best of more draws lies."""
    levels = np.random.default_rng(0).standard_normal(1000)[:, None].repeat(2, axis=1)
    pilot = Pilot(pd.DataFrame(), [{}] * 1000, levels, np.exp(levels), late=0.0)
    assert [largest(1), largest(2)] == pytest.approx([0, np.pi**-0.5], abs=1e-9)
    farther = 2.746 - 2.249  # Harter 1961, of 200 and of 50
    assert gained(pilot) == pytest.approx(1 - np.exp(-levels.std(ddof=1) * farther), abs=1e-3)


def test_part_that_is_as_good_falls_with_the_deviation() -> None:
    """All are as good where networks do not differ, and of a space that is wide hardly any but the best."""
    size = np.prod([len(values) for values in GENES.values()])
    alike, wide = (near(np.array([[0.0, 0.0], [1.0, 1.0]]) * by) for by in (0, 5))
    assert alike == 1
    assert 1 / size < wide < 2 / size


def test_larger_pilot_holds_the_smaller() -> None:
    """So more networks can be trained later; none comes twice."""
    few, many = drawn(10), drawn(200)
    assert many[:10] == few
    assert len({json.dumps(one) for one in many}) == 200


def test_failed_network_is_left_out() -> None:
    """It has no loss under one of the seeds."""
    genomes = [{"a": number, "b": 0} for number in range(3)]
    losses = {kind: [[0.5, 0.5], [0.5, None], [0.4, 0.4]] for kind in ("test", "fitness", "best_epoch")}
    found = pilot_of({"epochs": 20, "genomes": genomes, "features": [{"x": 1.0}] * 3, **losses})
    assert found.genes.to_dict("list") == {"a": [0, 2]}  # a gene that does not vary says nothing
    assert found.tests.shape == (2, 2)


def test_noise_is_on_the_labels_that_train_alone(place: Path) -> None:
    """What is validated and tested stays exact; the data set has another fingerprint, so nothing is recalled for it."""
    overrides = ["experiment=demo", "data.images=200", "data.image_size=32", f"store.root={place}"]
    made, classes = (load_data(compose([*overrides, f"task={task}"]), Progress()) for task in ("hardness", "grating"))
    noisy = with_noise(made, 0.1)
    held_out = np.concatenate([made.validation, made.test])
    assert np.array_equal(noisy.targets[held_out], made.targets[held_out])
    assert np.std(noisy.targets[made.train] - made.targets[made.train]) == pytest.approx(0.1, rel=0.5)
    assert noisy.facts.fingerprint != made.facts.fingerprint
    assert with_noise(made, 0.0) is made
    with pytest.raises(ValueError, match="classes"):
        with_noise(classes, 0.1)


def test_page_shows_the_pilots() -> None:
    """Every row is computed from results/pilots.json."""
    assert "\n".join(table_lines(recorded())) in (ROOT / "benchmarks/README.md").read_text(encoding="utf-8")
