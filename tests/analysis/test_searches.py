"""Promise: a search hands over what its re-estimates choose, and test scores only compare what was chosen."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.multitest import multipletests
from studies import around, network, study_of

from analysis.statistics.noise import Draws, noise
from analysis.studies.noise import Reestimates
from analysis.studies.searches import Searched, handed_over
from analysis.table import Between
from analysis.tables.rendering import as_markdown
from analysis.tables.searches import searches_table
from tacevo.records import Kind

#: Test accuracies of the searches' networks.
BASELINE, GOOD, BETTER = around(0.5, step=0.01), around(0.7, step=0.01), around(0.8, step=0.01)


def searched(name: str, scores: Mapping[str, Sequence[float]], losses: Mapping[str, Sequence[float]]) -> Searched:
    """Make a search by the test accuracies and the re-estimates of its networks; each has a record of 0.1."""
    study = study_of(scores, kind=Kind.classification)
    estimates = np.array(list(losses.values()))
    again = Reestimates(
        name="study",
        networks=tuple(map(network, losses)),
        estimates=tuple(map(tuple, estimates.tolist())),
        epochs=5,
        noise=noise(Draws(recorded=np.full(len(losses), 0.1), estimates=estimates)),
        rankings=(),
    )
    return Searched(name=name, study=study, again=again)


FIRST = searched(
    "grammar", {"baseline": BASELINE, "variant 1": GOOD}, {"baseline": [0.9, 0.8], "variant 1": [0.5, 0.6]}
)
SECOND = searched(
    "model",
    {"baseline": BASELINE, "variant 1": BETTER, "variant 2": GOOD},
    {"baseline": [0.9, 0.8], "variant 1": [0.7, 0.7], "variant 2": [0.3, 0.4]},
)


def test_re_estimates_choose_and_test_scores_do_not() -> None:
    """The second search has a network that tests better; it was not to be known when it was chosen."""
    first, second = handed_over([FIRST, SECOND])
    assert (first.network.name, first.reestimated) == ("variant 1", 0.55)
    assert (second.network.name, second.reestimated) == ("variant 2", 0.35)
    assert first.effects is None
    assert second.effects is not None
    assert second.effects.median_difference.estimate == 0
    assert second.p_holm == 1


def test_a_baseline_that_nothing_beats_is_handed_over() -> None:
    """A search that found nothing says so by what it hands over."""
    losses = {"baseline": [0.2, 0.2], "variant 1": [0.5, 0.6]}
    unlucky = searched("unlucky", {"baseline": BASELINE, "variant 1": GOOD}, losses)
    assert handed_over([FIRST, unlucky])[1].network.name == "baseline"


def test_comparison_is_that_of_scipy_and_statsmodels() -> None:
    """Mann-Whitney U against the first search, and Holm over all the others."""
    near, far = ([value + 0.004 for value in sample] for sample in (GOOD, BETTER))
    others = [
        searched(name, {"baseline": BASELINE, "variant 1": values}, {"baseline": [0.9], "variant 1": [0.5]})
        for name, values in (("near", near), ("far", far))
    ]
    _, *found = handed_over([FIRST, *others])
    p_values = [stats.mannwhitneyu(values, GOOD, method="exact").pvalue for values in (near, far)]
    expected = multipletests(p_values, method="holm")[1]
    assert [one.p_holm for one in found] == pytest.approx(list(expected), rel=1e-6)
    wins = np.mean([[(own > other) + (own == other) / 2 for other in GOOD] for own in near])
    assert found[0].effects is not None
    assert found[0].effects.a12.estimate == pytest.approx(wins)


def test_table_says_what_one_search_each_cannot_show() -> None:
    """A share of images is in per cent, its difference in points, and the first search is compared with nothing."""
    found = handed_over([FIRST, SECOND])
    table = searches_table(found)
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    assert [row["search"] for row in rows] == ["grammar", "model"]
    assert rows[0]["p, Holm"] is None
    assert found[1].effects is not None
    difference = found[1].effects.median_difference
    points = rows[1]["difference of medians (percentage points)"]
    assert isinstance(points, Between)
    assert (points.low, points.high) == pytest.approx((100 * difference.low, 100 * difference.high))
    assert any(note.startswith("One search each") for note in table.notes)
    assert "| 70.0 % [65.5, 74.5] |" in as_markdown(table)
