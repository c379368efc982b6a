"""Promise: every figure says what its records say, is as wide as a column, and has the same bytes whenever drawn.

What a person must judge, whether a figure is legible, no test here claims.
"""

import io
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from hand_runs import bounds_of, closed, elite, prompt_trial, rejected, run, trained
from kept import gratings
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image
from studies import study_of

from analysis.figures.candidates import ROWS, lineage, training_curves
from analysis.figures.maps import network_map, prompt_map
from analysis.figures.progress import fitness_evolution, growth, prompt_productivity, temperature, trainable
from analysis.figures.studies import confusion_matrices, reliability, seed_boxes
from analysis.figures.style import house_style, render
from analysis.runs.dynamics import by_prompt, progress
from analysis.runs.lineage import lineage as find_lineage
from analysis.studies.images import image_findings
from analysis.studies.scores import Study
from tacevo.records import Kind, Reason, Stage
from tacevo.search.archive import find_centroids

CENTROIDS = np.array(find_centroids(niches=9, dimensions=2, samples=300, seed=0))

SLOTS = [
    trained(0, 0, 0.8),
    trained(0, 1, 0.6, temperature=0.55, descriptors=(0.2, 11.0)),
    trained(1, 0, 0.4, parents=("g00s01",), prompt=0, temperature=0.62, descriptors=(0.4, 14.0)),
    trained(1, 1, 0.5, parents=("g00s00", "g00s01"), prompt=None),
    rejected(1, 2, Stage.policy, Reason.forbidden_import, prompt=1),
    rejected(2, 0, Stage.extract, Reason.no_class),
]
ELITES = [
    elite("g00s01", niche=2, fitness=0.6),
    elite("g01s00", niche=7, fitness=0.4),
]
TRIALS = (
    prompt_trial(niche=1, prompt=0, temperature=0.6, inserted=True, curiosity=1.7),
    prompt_trial(niche=4, prompt=1, temperature=0.65, inserted=False, curiosity=0.5),
)
RUN = replace(
    run(
        SLOTS,
        [closed(0, 0.6, trained=2, candidates=2), closed(1, 0.4, trained=2, candidates=3), closed(2, None, trained=0)],
        elites=ELITES,
        bounds=((0.1, 0.5), (10.0, 20.0)),
    ),
    prompt_trials=TRIALS,
)
#: Of the archive after each generation.
MEDIANS = [0.7, 0.5, 0.5]
CALIBRATED = image_findings(*gratings()).calibrations
FORCES = study_of({"baseline": [0.006, 0.007, 0.0065], "variant 1": [0.004, 0.005, 0.0045]})


def confused() -> Study:
    """Return a study of a classification in which every network mistakes one image of class b for a c."""
    networks = ("baseline", "variant 1", "variant 2", "variant 3", "variant 4")
    study = study_of(dict.fromkeys(networks, (0.9, 0.9)), kind=Kind.classification)
    counts = ((4, 0, 0), (0, 2, 1), (0, 0, 3))
    return replace(
        study,
        data=replace(study.data, names=("a", "b", "c")),
        scores=tuple(replace(one, confusion=counts) for one in study.scores),
    )


def of_networks(study: Study, count: int) -> Study:
    """Keep the first networks of a study."""
    return replace(study, networks=study.networks[:count])


DRAWN: dict[str, tuple[Callable[[], Figure], float]] = {
    "fitness_evolution": (lambda: fitness_evolution(RUN, MEDIANS), 3.5),
    "trainable": (lambda: trainable(progress(RUN)), 3.5),
    "growth": (lambda: growth(RUN, 9, 6), 3.5),
    "temperature": (lambda: temperature(RUN), 3.5),
    "network_map": (lambda: network_map(RUN, CENTROIDS), 3.5),
    "prompt_map": (lambda: prompt_map(RUN, CENTROIDS, range(9)), 3.5),
    "prompt_productivity": (lambda: prompt_productivity(by_prompt(RUN)), 3.5),
    "lineage": (lambda: lineage(find_lineage(RUN, "g01s01")), 3.5),
    "training_curves": (lambda: training_curves([SLOTS[0], SLOTS[2]]), 3.5),
    "seed_boxes": (lambda: seed_boxes(FORCES, {"variant 1": "better"}), 3.5),
    "confusion_matrix": (lambda: confusion_matrices(of_networks(confused(), 1)), 3.5),
    "confusion_of_two": (lambda: confusion_matrices(of_networks(confused(), 2)), 7.16),
    "reliability": (lambda: reliability("grating", CALIBRATED), 7.16),
    "confusion_matrices": (lambda: confusion_matrices(confused()), 7.16),
}


@pytest.fixture(scope="module", params=DRAWN)
def figure(request: pytest.FixtureRequest) -> tuple[Figure, bytes]:
    """Return every figure in turn, drawn once, and its picture."""
    drawn = DRAWN[request.param][0]()
    return drawn, render(drawn, ".png")


def texts(figure: Figure) -> list[str]:
    """List all words of a figure that is drawn."""
    return [text.get_text() for text in figure.findobj(Text) if isinstance(text, Text) and text.get_text()]


def line(axes: Axes, label: str) -> list[float]:
    """Return the heights of a labelled line."""
    (found,) = (one for one in axes.lines if one.get_label() == label)
    return [float(value) for value in np.asarray(found.get_ydata())]


def points(axes: Axes, marker: str) -> list[tuple[float, float]]:
    """List what is marked with one kind of marker."""
    marked = [np.asarray(one.get_xydata()) for one in axes.lines if one.get_marker() == marker]
    return [(float(x), float(y)) for pairs in marked for x, y in pairs]


def cells_of(axes: Axes, label: str | None) -> int:
    """Count the cells of a map: those with a label, or with None the coloured ones."""
    found = [one for one in axes.collections if isinstance(one, PolyCollection)]
    chosen = [one for one in found if (one.get_label() == label if label else one.get_array() is not None)]
    return sum(len(one.get_paths()) for one in chosen)


def test_figure_is_as_wide_as_its_columns(figure: tuple[Figure, bytes], request: pytest.FixtureRequest) -> None:
    """To the pixel: nothing is cropped or added when it is saved."""
    (width,) = (width for name, (_, width) in DRAWN.items() if f"[{name}]" in request.node.name)
    assert Image.open(io.BytesIO(figure[1])).width == int(width * 300)


def test_letters_have_7_or_8_points(figure: tuple[Figure, bytes]) -> None:
    """Sub- and superscripts aside, which are parts of a text."""
    sizes = {text.get_fontsize() for text in figure[0].findobj(Text) if isinstance(text, Text) and text.get_text()}
    assert sizes <= {7.0, 8.0}


def test_no_text_leaves_its_figure(figure: tuple[Figure, bytes]) -> None:
    """Every word that is drawn lies within the page; half a point of slack for what surrounds the letters."""
    drawn, _ = figure
    with house_style():
        drawn.draw_without_rendering()
    page = drawn.bbox.padded(0.5 * drawn.dpi / 72)
    hidden = [text for axes in drawn.axes for text in _hidden_ticks(axes)]
    shown = [text for text in drawn.findobj(Text) if isinstance(text, Text) and text.get_text() and text.get_visible()]
    assert shown
    for text in shown:
        if text not in hidden:
            box = text.get_window_extent()
            assert page.x0 <= box.x0, text.get_text()
            assert box.x1 <= page.x1, text.get_text()
            assert page.y0 <= box.y0, text.get_text()
            assert box.y1 <= page.y1, text.get_text()


def _hidden_ticks(axes: Axes) -> list[Text]:
    """List the labels of ticks outside the limits, which Matplotlib keeps and never draws."""
    hidden = []
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
        hidden += [label for tick in ticks if not low <= tick.get_loc() <= high for label in (tick.label1, tick.label2)]
    return hidden


@pytest.mark.parametrize("name", DRAWN)
def test_drawn_twice_it_has_the_same_bytes(name: str) -> None:
    """Two drawings of the same records are one file."""
    draw, _ = DRAWN[name]
    assert render(draw(), ".svg") == render(draw(), ".svg")


@pytest.mark.slow
def test_bytes_do_not_depend_on_the_process() -> None:
    """Neither the seed of Python's hashes nor the user's own Matplotlib settings nor the time enters a file."""
    code = (
        "import hashlib, sys, matplotlib; sys.path[:0] = ['tests/support', 'tests/analysis']; "
        "matplotlib.rcParams['font.size'] = 5 * int(sys.argv[1]);"
        "import test_figures as t; from analysis.figures.style import render;"
        "[print(hashlib.sha256(render(t.DRAWN[name][0](), ending)).hexdigest())"
        " for name in ('prompt_map', 'trainable', 'confusion_matrices') for ending in ('.pdf', '.svg', '.png')]"
    )
    outputs = set()
    for seed in ("1", "2"):
        command, variables = [sys.executable, "-c", code, seed], {**os.environ, "PYTHONHASHSEED": seed}
        root = Path(__file__).parents[2]
        done = subprocess.run(command, cwd=root, env=variables, capture_output=True, text=True, check=True)
        outputs.add(done.stdout)
    assert [len(output.split()) for output in outputs] == [9]


def test_fonts_are_embedded_as_truetype() -> None:
    """Type 3 fonts, which many journals refuse, are in no PDF."""
    content = render(network_map(RUN, CENTROIDS), ".pdf")
    assert b"/FontFile2" in content
    assert b"/Type3" not in content
    assert b"CreationDate" not in content


def test_text_of_an_svg_is_text() -> None:
    """It can be searched for and read out."""
    assert b">Architectural Diversity<" in render(network_map(RUN, CENTROIDS), ".svg")


def test_drawing_leaves_no_state_behind() -> None:
    """Neither the global settings change nor does pyplot, which keeps every figure, ever come in."""
    before = dict(mpl.rcParams)
    render(fitness_evolution(RUN, MEDIANS), ".png")
    assert dict(mpl.rcParams) == before
    code = "import sys, analysis.report.figure_list; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_map_draws_every_niche() -> None:
    """Held ones in colour, empty ones pale, none twice; axes in the units of the descriptors."""
    (axes, _) = network_map(RUN, CENTROIDS).axes
    assert cells_of(axes, None) == 2
    assert cells_of(axes, "empty") == 7
    assert (axes.get_xlim(), axes.get_ylim()) == ((0.1, 0.5), (10.0, 20.0))
    assert points(axes, "o") == [(0.2, 11.0), (0.4, 14.0)]
    assert points(axes, "*") == [(0.4, 14.0)]


def test_colours_say_where_they_are_logarithmic() -> None:
    """Losses of two elites are; a single one has no scale."""
    assert "validation loss of the elite (logarithmic scale)" in texts(network_map(RUN, CENTROIDS))
    assert "validation loss of the elite" in texts(network_map(replace(RUN, elites=(ELITES[0],)), CENTROIDS))


def test_elite_outside_fixed_bounds_stands_at_their_edge() -> None:
    """Its niche is the one at the edge; nothing of the map, the star included, vanishes, and the legend says why."""
    slots = [replace(slot, eff_ratio=25.0) if slot.id == "g01s00" else slot for slot in SLOTS]
    drawn = network_map(replace(RUN, candidates=tuple(slots)), CENTROIDS)
    axes, _ = drawn.axes
    assert points(axes, "X") == points(axes, "*") == [(0.4, 20.0)]
    assert points(axes, "o") == [(0.2, 11.0)]
    assert "outside the bounds" in texts(drawn)
    assert "outside the bounds" not in texts(network_map(RUN, CENTROIDS))


@pytest.mark.parametrize(("losses", "scale"), [((0.1, 1.0), "log"), ((0.2, 1.0), "linear"), ((0.0, 1.0), "linear")])
def test_losses_have_one_rule_for_their_axis(losses: tuple[float, float], scale: str) -> None:
    """Logarithmic from a factor of 10 on, else from 0 up, in the curves as in the evolution."""
    high, low = trained(0, 0, losses[1]), trained(1, 0, losses[0])
    told = replace(RUN, generations=tuple(closed(place, loss) for place, loss in enumerate(losses)))
    for drawn in (training_curves([high, low]), fitness_evolution(told, losses)):
        (axes,) = drawn.axes
        assert axes.get_yscale() == scale
        assert scale == "log" or axes.get_ylim()[0] == 0


def test_map_of_one_value_and_of_nothing_can_be_drawn() -> None:
    """A single elite, an axis without extent, a loss of 0, an empty archive."""
    one = replace(RUN, elites=(replace(ELITES[0], fitness=0.0),), bounds=bounds_of((0.3, 0.3), (10.0, 20.0)))
    axes, _ = network_map(one, CENTROIDS).axes
    assert axes.get_xlim() == pytest.approx((-0.2, 0.8))
    (axes,) = network_map(replace(RUN, elites=(), bounds=None), CENTROIDS).axes
    assert cells_of(axes, "empty") == 9


def test_prompt_map_has_instructions_and_temperature_as_axes() -> None:
    """Its trials stand at their instruction and temperature; a fruitless one is hatched, too."""
    (axes, bar) = prompt_map(RUN, CENTROIDS, range(9)).axes
    assert (axes.get_xlim(), axes.get_ylim()) == ((0.0, 1.0), (0.0, 1.0))
    assert points(axes, "o") == [(0.0, 0.6), (1.0, 0.65)]
    assert sum(collection.get_hatch() is not None for collection in axes.collections) == 1
    assert bar.get_ylabel() == "curiosity of the trial"


def test_niches_out_of_reach_are_shaded_and_hatched() -> None:
    """So that a niche that no search could fill is not taken for one that it failed to fill."""
    drawn = prompt_map(RUN, CENTROIDS, {1, 4, 7})
    (shaded,) = (one for one in drawn.axes[0].collections if one.get_hatch() == "....")
    assert len(shaded.get_paths()) == 6
    assert "out of reach" in texts(drawn)
    assert "out of reach" not in texts(prompt_map(RUN, CENTROIDS, range(9)))


def test_fitness_of_a_generation_without_training_is_a_gap() -> None:
    """Nothing is drawn where nothing was trained; the other values are the ledger's."""
    (axes,) = fitness_evolution(RUN, MEDIANS).axes
    assert line(axes, "best so far")[:2] == [0.6, 0.4]
    assert np.isnan(line(axes, "best so far")[2])
    assert np.isnan(line(axes, "median of new")[2])


def test_fitness_shows_the_archive_beside_the_new() -> None:
    """The archive's median is a curve of its own; that of a generation's candidates is not taken for it."""
    (axes,) = fitness_evolution(RUN, MEDIANS).axes
    assert line(axes, "archive median") == MEDIANS
    assert line(axes, "median of new")[:2] == [0.6, 0.4]


def test_bars_add_up_to_the_answers() -> None:
    """Stages that turned nobody away have no bar; each bar ends at the candidates of its generation."""
    (axes,) = trainable(progress(RUN)).axes
    labels = [container.get_label() for container in axes.containers]
    assert labels == ["trained", "no class found", "against the policy"]
    tops = np.max([[bar.get_y() + bar.get_height() for bar in group] for group in axes.containers], axis=0)
    assert tops.tolist() == [2, 3, 1]


def test_growth_shows_both_archives() -> None:
    """Coverage in per cent above, of the prompt archive among the niches that could be reached; QD-score below."""
    run = replace(RUN, generations=(replace(RUN.generations[0], prompt_coverage=0.25),))
    upper, lower = growth(run, 8, 4).axes
    assert line(upper, "networks") == [25.0]
    assert line(upper, "prompts (of reachable niches)") == [50.0]
    assert lower.get_ylabel() == "QD-score"


def test_every_request_has_its_temperature() -> None:
    """One dot a request; the baseline asked nobody."""
    (axes,) = temperature(RUN).axes
    assert len(line(axes, "requests")) == len(SLOTS) - 1


def test_instruction_without_a_trial_has_a_line_and_no_point() -> None:
    """The counts stand beside every instruction, so that 0 of 0 is not taken for 0."""
    drawn = prompt_productivity(by_prompt(replace(RUN, instructions=("refine", "widen", "never"))))
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
    named = replace(RUN, instructions=(name, name))
    study = confused()
    study = replace(study, data=replace(study.data, names=(name, "b", "c")))
    for drawn in (
        prompt_productivity(by_prompt(named)),
        lineage(find_lineage(named, "g01s00")),
        confusion_matrices(study),
    ):
        assert render(drawn, ".svg")
        assert name in texts(drawn)


def test_single_generation_has_one_tick() -> None:
    """Between generations there is nothing, so no tick stands at 0.03."""
    early = run(SLOTS[:2], [closed(0, 0.6)])
    for drawn in (lineage(find_lineage(early, "g00s01")), growth(early, 9, 6), fitness_evolution(early, [0.7])):
        axes = drawn.axes[-1]
        low, high = axes.get_xlim()
        assert [tick for tick in axes.get_xticks() if low <= tick <= high] == [0.0]


def test_markers_at_the_ends_of_an_axis_are_whole() -> None:
    """Coverage of 0 and 100 % is drawn over the frame, not cut by it."""
    assert not any(line.get_clip_on() for axes in growth(RUN, 9, 6).axes for line in axes.lines)


def test_long_lineage_shows_its_end_and_says_so() -> None:
    """The latest ancestors stay, the number of the others is told."""
    many = [trained(number, 0, parents=(f"g{number - 1:02}s00",)) for number in range(ROWS + 5)]
    found = texts(lineage(find_lineage(run(many, [closed(0)]), many[-1].id)))
    assert "made by (5 left out)" in found
    assert many[-1].id in found
    assert many[4].id not in found


def test_every_seed_is_a_point() -> None:
    """All seeds of a network stand at its box with their own values, and what was found stands above it."""
    drawn = seed_boxes(FORCES, {"variant 1": "better"})
    (axes,) = drawn.axes
    assert sorted(y for _, y in points(axes, "s")) == [0.006, 0.0065, 0.007]
    assert sorted(y for _, y in points(axes, "o")) == [0.004, 0.0045, 0.005]
    assert all(1.5 < x < 2.5 for x, _ in points(axes, "o"))
    assert "better" in texts(drawn)


@pytest.mark.parametrize(("networks", "name"), [(2, "variant 1"), (5, "variant 1"), (6, "variant\n1")])
def test_names_of_networks_are_broken_where_they_would_touch(networks: int, name: str) -> None:
    """The five of a usual study have room for them in one line."""
    scores = {"baseline": [0.1, 0.2], **{f"variant {number}": [0.1, 0.2] for number in range(1, networks)}}
    (axes,) = seed_boxes(study_of(scores), {}).axes
    assert [label.get_text() for label in axes.get_xticklabels()][1] == name


def test_confusion_shows_counts_and_shares_of_the_true_class() -> None:
    """One image of three is 33 % of its row; places without an image stay empty."""
    (axes,) = confusion_matrices(of_networks(confused(), 1)).axes
    found = {tuple(map(int, text.get_position())): text.get_text() for text in axes.texts}
    assert found == {(0, 0): "4\n100", (1, 1): "2\n67", (2, 1): "1\n33", (2, 2): "3\n100"}


def test_confusion_shows_every_network_at_its_median_seed() -> None:
    """Not one seed for all, which may be the best of one network and the worst of another."""
    study = study_of({"baseline": [1.0, 0.8, 0.9], "variant 1": [0.7, 0.8, 0.9]}, kind=Kind.classification)
    best = replace(study, scores=tuple(replace(one, confusion=_diagonal(one.seed + 1)) for one in study.scores))
    left, right = confusion_matrices(replace(best, data=replace(best.data, names=("a", "b")))).axes
    assert [axes.get_title() for axes in (left, right)] == ["baseline, seed 2", "variant 1, seed 1"]
    assert {text.get_text() for text in left.texts} == {"3\n100"}
    assert len(confusion_matrices(confused()).axes) == 5


def test_confusion_is_a_drawing() -> None:
    """Its cells stay sharp at every size; an image of seven pixels a side is smoothed by some readers."""
    assert b"<image" not in render(confusion_matrices(confused()), ".svg")


def _diagonal(count: int) -> tuple[tuple[int, ...], ...]:
    """Return a matrix in which all is right."""
    return ((count, 0), (0, count))


def test_confusion_that_was_not_recorded_is_refused() -> None:
    """A regression confuses nothing."""
    with pytest.raises(ValueError, match=re.escape("force has no confusion matrix of baseline, seed 2")):
        confusion_matrices(FORCES)
