"""Promise: the figures of a sweep draw medians over quartiles and every seed, and tell no two arms by colour alone."""

import functools
from itertools import pairwise

import numpy as np
import pytest
from hand_sweeps import NONE, WORSE, compared, curves_of, jobs_of
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.ablations import _ENDS, curves, final_values, forest
from analysis.figures.style import BLACK
from analysis.sweeps.ablation import compare_arms
from analysis.sweeps.arm_metrics import Metric
from tacevo.storage.sweep_directory import Job

TWO = (*jobs_of("none", NONE), *jobs_of("worse", WORSE))
_, FOUND = compared(*TWO)
CURVES = curves_of(TWO)
ARMS = [f"arm number {number} of a long name, and so on" for number in range(12)]
MANY = (*jobs_of("none", NONE), *(job for name in ARMS for job in jobs_of(name, WORSE)))


@functools.cache
def of_many() -> tuple[Figure, Figure]:
    """Draw the curves and the final values of thirteen arms."""
    _, ablation = compared(*MANY)
    return curves(ablation, curves_of(MANY)), final_values(ablation)


def heights(axes: Axes, arm: str) -> list[float]:
    """Return the curve of an arm."""
    (line,) = (one for one in axes.lines if one.get_label() == arm)
    return [float(value) for value in np.asarray(line.get_ydata())]


def test_curves_are_medians_over_quartiles() -> None:
    """By hand: from 0.8 to 0.42, the quartiles of 0.40 to 0.44 are 0.41 and 0.43."""
    figure = curves(FOUND, CURVES)
    assert heights(figure.axes[0], "none") == pytest.approx([0.8, 0.42])
    band = figure.axes[0].collections[0].get_paths()[0].vertices
    ends = [float(y) for x, y in np.asarray(band) if x == 1]
    assert (min(ends), max(ends)) == pytest.approx((0.41, 0.43))


def test_archives_are_those_in_common() -> None:
    """Coverage rises from one of two niches to both, in per cent; the axes say which archive it is."""
    figure = curves(FOUND, CURVES)
    assert heights(figure.axes[2], "none") == [50, 100]
    assert heights(figure.axes[1], "none") == pytest.approx([1 / 1.8, 1 / 1.8 + 1 / 1.42])
    for drawn in (figure, final_values(FOUND)):
        words = [axes.get_ylabel() + axes.get_xlabel().replace("\n", " ") for axes in drawn.axes[-2:]]
        assert all("common archive" in word for word in words)


def test_forest_shows_every_other_arm_against_the_reference() -> None:
    """The difference of medians that the table has, with its interval; arms that are not compared say why."""
    figure = forest(FOUND)
    (axes,) = figure.axes
    frame = FOUND.arms[FOUND.first]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["worse"]
    (point,) = [line for line in axes.lines if line.get_marker() == "o"]
    assert float(np.asarray(point.get_xdata())[0]) == frame.at["worse", "difference"]
    assert axes.get_xlim()[0] < 0 < axes.get_xlim()[1]
    (alone,) = forest(compared(*jobs_of("none", NONE), *jobs_of("few", WORSE[:1]))[1]).axes
    assert "too few seeds" in [text.get_text() for text in alone.texts]


def test_words_below_one_panel_do_not_reach_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many they are."""
    monkeypatch.setitem(_ENDS, Metric.qd_score, ("word " * 12, 1))
    figure = final_values(FOUND)
    figure.draw_without_rendering()
    below = [axes.xaxis.label.get_window_extent() for axes in figure.axes]
    assert len(below) > 2
    assert all(one.x1 < other.x0 for one, other in pairwise(below))


@pytest.mark.slow
def test_no_two_arms_look_alike() -> None:
    """Thirteen arms differ in dash or marker, too, and not in colour alone; `none` is black and solid."""
    lines = [one for one in of_many()[0].axes[0].lines if not str(one.get_label()).startswith("_")]
    assert (lines[0].get_color(), lines[0].get_marker(), lines[0].get_linestyle()) == (BLACK, "o", "-")
    assert len({(str(line.get_marker()), line.get_linestyle() == "-") for line in lines}) == 13


def test_every_seed_is_a_point() -> None:
    """Final values are all there, each once, in the row of its arm."""
    axes = final_values(FOUND).axes[0]
    drawn = [line for line in axes.lines if line.get_marker() not in ("None", "", None)]
    assert [sorted(map(float, np.asarray(line.get_xdata()))) for line in drawn] == [list(NONE), list(WORSE)]
    for row, line in enumerate(drawn):
        assert all(abs(float(y) - row) < 0.5 for y in np.asarray(line.get_ydata()))
    assert [label.get_text() for label in axes.get_yticklabels()] == ["none", "worse"]


@pytest.mark.slow
def test_arms_that_lie_on_each_other_are_named() -> None:
    """Above each panel in which one hides the other; elsewhere there is no title."""
    twins = (*TWO, *jobs_of("twin", WORSE))
    figure = curves(compared(*twins)[1], curves_of(twins))
    assert [axes.get_title() for axes in figure.axes] == [*["worse = twin"] * 2, "none = worse = twin"]
    assert [axes.get_title() for axes in curves(FOUND, CURVES).axes] == ["", "", "none = worse"]


def test_few_values_have_no_box() -> None:
    """Of five seeds there are points and the median; of six a box as well."""
    for seeds, boxes in ((5, 0), (6, 2)):
        jobs = (*jobs_of("none", NONE[:1] * seeds), *jobs_of("worse", WORSE[:1] * seeds))
        axes = final_values(compared(*jobs)[1]).axes[0]
        assert len(axes.patches) == boxes
        assert sum(line.get_linewidth() == 1.4 for line in axes.lines) == 2  # medians


def test_reference_line_is_its_median() -> None:
    """And there is none without it."""
    dotted = [line for line in final_values(FOUND).axes[0].lines if line.get_linestyle() == ":"]
    assert [float(x) for line in dotted for x in np.asarray(line.get_xdata())] == [0.42, 0.42]
    _, without = compared(*jobs_of("a", NONE), *jobs_of("b", WORSE))
    assert not [line for line in final_values(without).axes[0].lines if line.get_linestyle() == ":"]


def test_unknown_start_is_not_drawn() -> None:
    """Before anything was trained there is no best."""
    unknown = CURVES.assign(best_fitness=CURVES.best_fitness.where(CURVES.generation > 0))
    assert np.isnan(heights(curves(FOUND, unknown).axes[0], "none")[0])


def test_single_seed_is_drawn() -> None:
    """A curve without a band's width, and one point in the middle of its row."""
    alone = jobs_of("none", NONE[:1])
    _, one = compared(*alone)
    assert heights(curves(one, curves_of(alone)).axes[0], "none") == pytest.approx([0.8, 0.4])
    points = [line for line in final_values(one).axes[0].lines if line.get_marker() == "o"]
    assert [float(y) for line in points for y in np.asarray(line.get_ydata())] == [0]


def test_arm_that_lost_every_job_has_an_empty_row_and_no_curve() -> None:
    """Its failures are in the tables; the others are drawn as without it."""
    lost = Job(name="lost-seed0", arm="lost", seed=0, overrides=(), config="")
    ablation = compare_arms(FOUND.jobs, failed=[lost])
    assert [line.get_label() for line in curves(ablation, CURVES).axes[0].lines] == ["none", "worse"]
    axes = final_values(ablation).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["none", "worse", "lost"]
    ends = [place for line in axes.lines for place in np.asarray(line.get_xydata()) if np.isfinite(place).all()]
    assert any(0.5 < y < 1.5 for _, y in ends)
    assert not any(1.5 < y < 2.5 for _, y in ends)


def test_figures_are_as_wide_as_two_columns() -> None:
    """Also where arms have long names, and the panels are still there."""
    for figure in of_many():
        assert figure.get_figwidth() == 7.16
        figure.draw_without_rendering()
        assert all(axes.get_window_extent().width > 0.12 * figure.bbox.width for axes in figure.axes)
