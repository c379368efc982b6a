"""Promise: every figure is as wide as a column, of one size of letters, and has the same bytes whenever drawn.

What a person must judge, whether a figure is legible, no test here claims.
"""

import io
import os
import subprocess
import sys

import matplotlib as mpl
import pytest
from drawings import CENTROIDS, DRAWN, MEDIANS, RUN
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from analysis.figures.by_generation import fitness_evolution
from analysis.figures.maps import network_map
from analysis.figures.style import house_style, render

NAMES = [pytest.param(name, marks=pytest.mark.room("Pareto")) if name == "pareto" else name for name in DRAWN]


@pytest.fixture(scope="module", params=NAMES)
def figure(request: pytest.FixtureRequest) -> tuple[Figure, float]:
    """Return every figure in turn, drawn once, and the width that it should have, in inches."""
    draw, width = DRAWN[request.param]
    return draw(), width


@pytest.mark.few(4)
def test_figure_is_as_wide_as_its_columns(figure: tuple[Figure, float]) -> None:
    """And nothing is cropped or added when it is saved, which is tried with few points an inch."""
    drawn, width = figure
    assert drawn.get_figwidth() == width
    with house_style():
        drawn.savefig(saved := io.BytesIO(), dpi=50)
    assert Image.open(saved).width == int(width * 50)


def test_letters_have_7_or_8_points(figure: tuple[Figure, float]) -> None:
    """Sub- and superscripts aside, which are parts of a text."""
    sizes = {text.get_fontsize() for text in figure[0].findobj(Text) if isinstance(text, Text) and text.get_text()}
    assert sizes <= {7.0, 8.0}


@pytest.mark.few(4)
def test_no_text_leaves_its_figure(figure: tuple[Figure, float]) -> None:
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


@pytest.mark.few(5)
@pytest.mark.parametrize("name", NAMES)
def test_drawn_twice_it_has_the_same_bytes(name: str) -> None:
    """Two drawings of the same records are one file."""
    draw, _ = DRAWN[name]
    assert render(draw(), ".svg") == render(draw(), ".svg")


@pytest.mark.slow
def test_bytes_do_not_depend_on_the_process() -> None:
    """Neither the seed of Python's hashes nor the user's own Matplotlib settings nor the time enters a file."""
    code = (
        "import hashlib, sys, matplotlib; "
        "matplotlib.rcParams['font.size'] = 5 * int(sys.argv[1]);"
        "from drawings import DRAWN; from analysis.figures.style import render;"
        "[print(hashlib.sha256(render(DRAWN[name][0](), ending)).hexdigest())"
        " for name in ('prompt_map', 'trainable', 'confusion_matrices') for ending in ('.pdf', '.svg', '.png')]"
    )
    outputs, path = set(), os.pathsep.join(sys.path)
    for seed in ("1", "2"):
        command = [sys.executable, "-c", code, seed]
        variables = {**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": seed}
        done = subprocess.run(command, env=variables, capture_output=True, text=True, check=True)
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


@pytest.mark.slow
def test_drawing_leaves_no_state_behind() -> None:
    """Neither the global settings change nor does pyplot, which keeps every figure, ever come in."""
    before = dict(mpl.rcParams)
    render(fitness_evolution(RUN, MEDIANS), ".png")
    assert dict(mpl.rcParams) == before
    code = "import sys, analysis.report.figure_list; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
