"""Promise: every figure says what its records say."""

from dataclasses import replace

import numpy as np
import pytest
from drawings import CENTROIDS, ELITES, FORCES, MEDIANS, RUN, SLOTS, confused, of_networks
from hand_runs import altered, bounds_of, closed, run, trained
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.text import Text
from studies import study_of

from analysis.figures.axes import RoundLogLocator
from analysis.figures.by_generation import fitness_evolution, growth, prompt_productivity, temperature, trainable
from analysis.figures.candidates import ROWS, lineage, training_curves
from analysis.figures.maps import network_map, prompt_map
from analysis.figures.studies import confusion_matrices, seed_boxes
from analysis.figures.style import render
from analysis.runs.dynamics import by_prompt, progress
from analysis.runs.lineage import lineage as find_lineage
from analysis.runs.niches import prompt_rows
from tacevo.records import Kind


def texts(figure: Figure) -> list[str]:
    """List all words of a figure that is drawn."""
    return [text.get_text() for text in figure.findobj(Text) if isinstance(text, Text) and text.get_text()]


def line(axes: Axes, label: str) -> list[float]:
    """Return the heights of a labelled line."""
    (drawn,) = (one for one in axes.lines if one.get_label() == label)
    return [float(value) for value in np.asarray(drawn.get_ydata())]


def points(axes: Axes, marker: str) -> list[tuple[float, float]]:
    """List what is marked with one kind of marker."""
    marked = [np.asarray(one.get_xydata()) for one in axes.lines if one.get_marker() == marker]
    return [(float(x), float(y)) for pairs in marked for x, y in pairs]


def cells_of(axes: Axes, label: str | None) -> int:
    """Count the cells of a map: those with a label, or with None the coloured ones."""
    polygons = [one for one in axes.collections if isinstance(one, PolyCollection)]
    chosen = [one for one in polygons if (one.get_label() == label if label else one.get_array() is not None)]
    return sum(len(one.get_paths()) for one in chosen)


def test_map_draws_every_niche() -> None:
    """Held ones in colour, empty ones pale, none twice; axes in the units of the descriptors."""
    (axes, _) = network_map(RUN, CENTROIDS).axes
    assert cells_of(axes, None) == 2
    assert cells_of(axes, "empty") == 7
    assert (axes.get_xlim(), axes.get_ylim()) == ((0.1, 0.5), (10.0, 20.0))
    assert points(axes, "o") == [(0.2, 11.0), (0.4, 14.0)]
    assert points(axes, "*") == [(0.4, 14.0)]
    assert {"empty", "elite", "best"} <= set(texts(network_map(RUN, CENTROIDS)))


def test_elite_outside_fixed_bounds_stands_at_their_edge() -> None:
    """Its niche is the one at the edge; nothing of the map, the star included, vanishes, and the legend says why."""
    slots = [replace(slot, eff_ratio=25.0) if slot.id == "g01s00" else slot for slot in SLOTS]
    drawn = network_map(altered(RUN, candidates=tuple(slots)), CENTROIDS)
    axes, _ = drawn.axes
    assert points(axes, "X") == points(axes, "*") == [(0.4, 20.0)]
    assert points(axes, "o") == [(0.2, 11.0)]
    assert "outside the bounds" in texts(drawn)
    assert "outside the bounds" not in texts(network_map(RUN, CENTROIDS))


@pytest.mark.parametrize(("losses", "scale"), [((0.1, 1.0), "log"), ((0.2, 1.0), "linear"), ((0.0, 1.0), "linear")])
def test_losses_have_one_rule_for_their_axis(losses: tuple[float, float], scale: str) -> None:
    """Logarithmic from a factor of 10 on, else from 0 up, in the curves as in the evolution."""
    high, low = trained(0, 0, losses[1]), trained(1, 0, losses[0])
    told = altered(RUN, generations=tuple(closed(place, loss) for place, loss in enumerate(losses)))
    for drawn in (training_curves([high, low]), fitness_evolution(told, losses)):
        (axes,) = drawn.axes
        assert axes.get_yscale() == scale
        assert scale == "log" or axes.get_ylim()[0] == 0


def test_map_of_one_value_and_of_nothing_can_be_drawn() -> None:
    """A single elite, an axis without extent, a loss of 0, an empty archive."""
    one = altered(RUN, elites=(replace(ELITES[0], fitness=0.0),), bounds=bounds_of((0.3, 0.3), (10.0, 20.0)))
    axes, _ = network_map(one, CENTROIDS).axes
    assert axes.get_xlim() == pytest.approx((-0.2, 0.8))
    (axes,) = network_map(altered(RUN, elites=(), bounds=None), CENTROIDS).axes
    assert cells_of(axes, "empty") == 9


def test_prompt_map_has_a_row_for_each_instruction() -> None:
    """Its trials stand in the row of their instruction at their temperature; a fruitless one is hatched, too."""
    (axes, bar) = prompt_map(RUN, CENTROIDS, range(9)).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == list(RUN.instructions)
    low, high = axes.get_xlim()
    assert (-0.1 < low < 0, 1 < high < 1.1) == (True, True)  # a trial at an end is whole
    assert points(axes, "o") == [(0.6, 0.0), (0.65, 1.0)]
    assert sum(collection.get_hatch() is not None for collection in axes.collections) == 1
    assert bar.get_ylabel() == "curiosity of the trial"


def test_niches_out_of_reach_are_shaded_and_hatched() -> None:
    """So that a niche that no search could fill is not taken for one that it failed to fill."""
    drawn = prompt_map(RUN, CENTROIDS, {1, 4, 7})
    held, reached = {trial.niche for trial in RUN.prompt_trials}, {1, 4, 7}
    beyond = [piece for row in prompt_rows(CENTROIDS, 2) for piece in row if piece[0] not in held | reached]
    (shaded,) = (one for one in drawn.axes[0].collections if one.get_hatch() == "....")
    assert len(shaded.get_paths()) == len(beyond) > 0
    assert "out of reach" in texts(drawn)
    assert "out of reach" not in texts(prompt_map(RUN, CENTROIDS, range(9)))


@pytest.mark.parametrize("last", [1, 3, 7, 20, 33])
def test_no_tick_lies_beyond_the_generations(last: int) -> None:
    """Neither before 0 nor after the last one, and all are whole, whatever is drawn over them."""
    generations = tuple(closed(number, 0.9 - number / 100) for number in range(last + 1))
    slots = [trained(number, 0, 0.9 - number / 100) for number in range(last + 1)]
    told = altered(run(slots, generations), candidates=tuple(slots))
    shown = (
        *(fitness_evolution(told, [0.5] * (last + 1)), growth(told, 9, 6), temperature(told)),
        *(trainable(progress(told)), lineage(find_lineage(told, slots[-1].id))),
    )
    for axes in (axes for drawn in shown for axes in drawn.axes):
        ticks = axes.get_xticks()
        assert all(0 <= tick <= last and tick == int(tick) for tick in ticks)
        assert len(ticks) > 0


@pytest.mark.parametrize(
    ("ends", "ticks"),
    [
        ((0.07, 0.95), [0.1, 0.2, 0.5]),
        ((0.004, 3.0), [0.01, 0.1, 1.0]),
        ((0.31, 0.44), [0.35, 0.4]),
        ((1.1, 1.9), [1.2, 1.4, 1.6, 1.8]),
    ],
)
def test_losses_have_round_ticks(ends: tuple[float, float], ticks: list[float]) -> None:
    """Powers of ten, or 1, 2 and 5 of a decade, or what is round between these; as axis and as colourbar."""
    assert RoundLogLocator().tick_values(*ends) == pytest.approx(ticks)


def test_fitness_stands_beside_baseline_and_reestimates() -> None:
    """A record flatters: every network that was trained again has its other loss, joined to the one on record."""
    drawn = fitness_evolution(RUN, MEDIANS, {"g00s00": 0.85, "g01s00": 0.7})
    (axes,) = drawn.axes
    assert set(line(axes, "baseline")) == {RUN.baseline.fitness}
    assert sorted(y for _, y in points(axes, "D")) == [0.7, 0.85]
    lines = [np.asarray(one.get_xydata()) for one in axes.lines]
    assert any(len(ends) == 2 and ends[0, 0] == ends[1, 0] and sorted(ends[:, 1]) == [0.4, 0.7] for ends in lines)
    assert {"with other seeds", "on record", "g00s00", "g01s00"} <= {*texts(drawn)}
    assert "re-estimated" not in texts(fitness_evolution(RUN, MEDIANS))


def test_axis_says_how_much_one_image_is() -> None:
    """Of a small test set, whose accuracies are steps; of a large one nobody sees them, and errors have none."""
    small = seed_boxes(confused(), {}).axes[0].get_ylabel()
    assert "1 image = 10.0 points" in small
    many = tuple(replace(one, confusion=((900, 0, 0), (0, 20, 0), (0, 0, 3))) for one in confused().scores)
    assert "1 image" not in seed_boxes(replace(confused(), scores=many), {}).axes[0].get_ylabel()
    assert "1 image" not in seed_boxes(FORCES, {}).axes[0].get_ylabel()


def test_fitness_shows_the_archive_beside_the_new_and_a_gap_without_training() -> None:
    """The archive's median is a curve of its own; nothing is drawn where nothing was trained."""
    (axes,) = fitness_evolution(RUN, MEDIANS).axes
    assert line(axes, "archive median") == MEDIANS
    assert line(axes, "best so far") == pytest.approx([0.6, 0.4, np.nan], nan_ok=True)
    assert line(axes, "median of new") == pytest.approx([0.6, 0.4, np.nan], nan_ok=True)


def test_bars_add_up_to_the_answers() -> None:
    """Stages that turned nobody away have no bar; each bar ends at the candidates of its generation."""
    (axes,) = trainable(progress(RUN)).axes
    labels = [container.get_label() for container in axes.containers]
    assert labels == ["trained", "no class found", "against the policy"]
    tops = np.max([[bar.get_y() + bar.get_height() for bar in group] for group in axes.containers], axis=0)
    assert tops.tolist() == [2, 3, 1]


def test_skipped_candidates_have_a_bar_of_their_own() -> None:
    """It stands on that of the trained ones; a run without any has none."""
    generations = progress(RUN)
    (axes,) = trainable(generations.assign(skipped=2)).axes
    (bars,) = [bars for bars in axes.containers if bars.get_label() == "skipped"]
    assert [bar.get_y() for bar in bars] == generations.trained.tolist()
    assert {bar.get_height() for bar in bars} == {2}
    assert "skipped" not in [bars.get_label() for bars in trainable(generations).axes[0].containers]


def test_growth_shows_both_archives() -> None:
    """Coverage in per cent above, of the prompt archive among the niches that could be reached; QD-score below."""
    run = altered(RUN, generations=(replace(RUN.generations[0], prompt_coverage=0.25),))
    upper, lower = growth(run, 8, 4).axes
    assert line(upper, "networks") == [25.0]
    assert line(upper, "prompts (of the 4 niches in reach, of 8)") == [50.0]
    assert lower.get_ylabel() == "QD-score"


def test_every_request_has_its_temperature() -> None:
    """One dot a request; the baseline asked nobody."""
    (axes,) = temperature(RUN).axes
    assert len(line(axes, "requests")) == len(SLOTS) - 1


def test_instruction_without_a_trial_has_a_line_and_no_point() -> None:
    """The counts stand beside every instruction, so that 0 of 0 is not taken for 0."""
    drawn = prompt_productivity(by_prompt(altered(RUN, instructions=("refine", "widen", "never"))))
    (axes,) = drawn.axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["refine", "widen", "never"]
    assert points(axes, "o") == [(0.5, 0.0), (0.0, 1.0)]
    assert [text.get_text() for text in axes.texts] == ["1/2", "0/1", "0/0"]


def test_lineage_names_what_made_each_ancestor() -> None:
    """Instruction or operator, and the loss; every known parent has its edge."""
    drawn = lineage(find_lineage(RUN, "g01s01"))
    assert {"baseline", "refine", "crossover", "g01s01", "0.500"} <= set(texts(drawn))
    assert sum(len(np.asarray(one.get_xdata())) == 2 for one in drawn.axes[0].lines) == 3


def test_names_of_users_are_no_formulas() -> None:
    """An instruction or a class whose name Matplotlib would read as broken mathematics is written as it is."""
    name = r"50$ or $\nonsense$"
    named = altered(RUN, instructions=(name, name))
    study = confused()
    study = replace(study, data=replace(study.data, names=(name, "b", "c")))
    for drawn in (
        prompt_productivity(by_prompt(named)),
        lineage(find_lineage(named, "g01s00")),
        confusion_matrices(study),
    ):
        assert render(drawn, ".svg")
        assert name in texts(drawn)


def test_long_lineage_shows_its_end_and_says_so() -> None:
    """The latest ancestors stay, the number of the others is told."""
    many = [trained(number, 0, parents=(f"g{number - 1:02}s00",)) for number in range(ROWS + 5)]
    words = texts(lineage(find_lineage(run(many, [closed(0)]), many[-1].id)))
    assert "made by (5 left out)" in words
    assert many[-1].id in words
    assert many[4].id not in words


def test_every_seed_is_a_point() -> None:
    """All seeds of a network stand at its box with their own values, and what was found stands above it."""
    drawn = seed_boxes(FORCES, {"variant 1": "better"})
    (axes,) = drawn.axes
    assert sorted(y for _, y in points(axes, "s")) == [0.006, 0.0065, 0.007]
    assert sorted(y for _, y in points(axes, "o")) == [0.004, 0.0045, 0.005]
    assert all(1.5 < x < 2.5 for x, _ in points(axes, "o"))
    assert "better" in texts(drawn)


def test_regression_has_no_confusion() -> None:
    """It confuses nothing."""
    with pytest.raises(ValueError, match="force"):
        confusion_matrices(FORCES)


def test_confusion_shows_counts_and_shares_of_the_true_class() -> None:
    """One image of three is 33 % of its row; places without an image stay empty."""
    (axes,) = confusion_matrices(of_networks(confused(), 1)).axes
    words = {tuple(map(int, text.get_position())): text.get_text() for text in axes.texts}
    assert words == {(0, 0): "4\n100", (1, 1): "2\n67", (2, 1): "1\n33", (2, 2): "3\n100"}


def test_confusion_shows_every_network_at_its_median_seed() -> None:
    """Not one seed for all, which may be the best of one network and the worst of another."""
    study = study_of({"baseline": [1.0, 0.8, 0.9], "variant 1": [0.7, 0.8, 0.9]}, kind=Kind.classification)
    best = replace(study, scores=tuple(replace(one, confusion=_diagonal(one.seed + 1)) for one in study.scores))
    drawn = confusion_matrices(replace(best, data=replace(best.data, names=("a", "b"))))
    left, right = drawn.axes
    assert [axes.get_title() for axes in (left, right)] == [
        "baseline, seed 2",
        f"{study.networks[1].whole_name}, seed 1",
    ]
    assert {text.get_text() for text in left.texts} == {"3\n100"}
    assert any("per cent of the true class" in text and "median" in text for text in texts(drawn))
    assert len(confusion_matrices(confused()).axes) == 5


def _diagonal(count: int) -> tuple[tuple[int, ...], ...]:
    """Return a matrix in which all is right."""
    return ((count, 0), (0, count))
