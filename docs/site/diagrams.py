"""Draw the diagrams of pages that explain: boxes in rows, and what leads from one to the next.

python docs/site/diagrams.py docs/figures
"""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from analysis.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILLION, house_style, new_figure, render


class Box(NamedTuple):
    """A box with a title; its lines are divided by line breaks."""

    title: str
    text: str
    colour: str = BLACK


_GAP = 0.2


@house_style()
def checked() -> Figure:
    """Draw a column for each kind of record: what it is above, and below what speaks for it."""
    records = [
        Box("answers", "what the model\nwrote"),
        Box("trainings", "losses and weights\nof each candidate"),
        Box("decisions", "gate, niches, parents,\nboth archives"),
        Box("scores", "tests, p values,\nverdicts"),
        Box("pages", "figures, texts,\nolder tables"),
    ]
    checks = [
        Box("no command", "taken as recorded:\nnobody can show\nwho wrote them", GREY),
        Box("replay --retrain", "trains again, and\ncompares the bits", ORANGE),
        Box("replay", "computes again from\nanswers and trainings", BLUE),
        Box("replay", "computes again from\nthe predictions", BLUE),
        Box("bundle digest", "compare it with the\none that is cited", GREEN),
    ]
    axes = _canvas(2.0, 5)
    _row(axes, records, 1.35, 0.75)
    _row(axes, checks, 0.0, 0.95)
    for place in range(len(checks)):
        _arrow(axes, (_middle(place), 0.95), (_middle(place), 1.35))
    return axes.get_figure()


@house_style()
def gate() -> Figure:
    """Draw the stages of the gate, and what each of them rejects."""
    stages = [
        Box("answer", "text of a model"),
        Box("extract", "finds the class\nin the text", BLUE),
        Box("policy", "reads the code,\nruns nothing", BLUE),
        Box("probe", "builds and runs it\nin the sandbox", ORANGE),
        Box("candidate", "may be trained", GREEN),
    ]
    reasons = {
        1: "no class, cut off,\nseveral versions",
        2: "imports, files, names\nthat it may not use",
        3: "wrong shape, no gradient,\ntoo large, not\ndeterministic",
    }
    axes = _canvas(1.8, 5)
    _row(axes, stages, 1.0, 0.75, joined=True)
    for place, reason in reasons.items():
        _arrow(axes, (_middle(place), 1.0), (_middle(place), 0.68), VERMILLION)
        axes.text(_middle(place), 0.62, reason, ha="center", va="top", color=VERMILLION)
    axes.text(_middle(0), 0.62, "rejected where an\narrow leads down:", ha="center", va="top", color=VERMILLION)
    return axes.get_figure()


@house_style()
def walls() -> Figure:
    """Draw the processes between a search and the code of a model, and what each of them has."""
    processes = [
        Box("search", "keys, labels, ledger;\nnever runs an answer", GREEN),
        Box("zygote", "torch and the data,\nimported once", BLUE),
        Box("supervisor", "one for each job:\nlimits, and the kill", BLUE),
        Box("candidate", "the model's code:\nmemory and one pipe", VERMILLION),
    ]
    axes = _canvas(1.6, 4)
    _row(axes, processes, 0.75, 0.75, joined=True)
    for height, wall in enumerate(
        ("no test label; with Landlock", "and seccomp also: no file, no", "network, process or signal")
    ):
        axes.text(_middle(3), 0.56 - 0.2 * height, wall, ha="center", va="center", color=VERMILLION)
    return axes.get_figure()


@house_style()
def question() -> Figure:
    """Draw how an answer is looked up under the hash of its question, and asked for once."""
    steps = [
        Box("question", "model, text, settings,\nnumber of the draw"),
        Box("key", "SHA-256 of exactly\nthese", BLUE),
        Box("store", "cache/completions:\nis there an answer?", BLUE),
        Box("answer", "the same bytes for\never", GREEN),
    ]
    axes = _canvas(1.9, 4)
    _row(axes, steps, 1.15, 0.75, joined=True)
    axes.text((_middle(2) + _middle(3)) / 2, 1.63, "yes", ha="center", va="center", color=GREEN)
    _box(axes, Box("model", "asked and paid once, and\nwritten before it is used", ORANGE), _middle(2) - 0.5, 0.0, 0.75)
    _arrow(axes, (_middle(2) - 0.15, 1.15), (_middle(2) - 0.15, 0.75))
    _arrow(axes, (_middle(2) + 0.15, 0.75), (_middle(2) + 0.15, 1.15))
    axes.text(_middle(2) - 0.2, 0.95, "no", ha="right", va="center", color=ORANGE)
    replayed = "in a replay an answer that is\nmissing is an error:\nno model is ever asked"
    axes.text(_middle(3), 0.4, replayed, ha="center", va="center", color=GREY)
    return axes.get_figure()


@house_style()
def plugged() -> Figure:
    """Draw where parts of a user's own plug into a search."""
    steps = [
        Box("propose", "who are the parents,\nwhat is asked"),
        Box("answer", "a model, or another\nprogram"),
        Box("train", "on images, on this\nmachine or others"),
        Box("keep", "which network stays,\nand in which niche"),
        Box("write", "logs, tables, figures"),
    ]
    parts = [
        "parents\nprompts\ntemperatures",
        "providers",
        "sources\nexecutors",
        "fitness\ndescriptors\narchives",
        "trackers\noutputs\ncommands",
    ]
    axes = _canvas(1.9, 5)
    _row(axes, steps, 1.2, 0.75, joined=True)
    for place, names in enumerate(parts):
        _arrow(axes, (_middle(place), 0.75), (_middle(place), 1.2))
        axes.text(_middle(place), 0.7, names, ha="center", va="top", color=BLUE)
    return axes.get_figure()


@house_style()
def numerics() -> Figure:
    """Draw which machines give equal bits under which numerics."""
    machines = ("the same machine", "another CPU\nwith AVX-512", "another CPU\nwith AVX2", "another GPU\nof this model")
    equal = {
        "portable": (True, True, True, None),
        "portable512": (True, True, False, None),
        "fast": (True, False, False, None),
        "fast, on a GPU": (True, None, None, True),
    }
    figure, (axes,) = new_figure("double", 2.1)
    axes.set(xlim=(-1.2, 3.6), ylim=(4.3, -1.3))
    axes.axis("off")
    for column, machine in enumerate(machines):
        axes.text(column, -0.9, machine, ha="center", va="center")
    for row, (name, cells) in enumerate(equal.items()):
        axes.text(-1.15, row, name, ha="left", va="center", weight="bold")
        for column, is_equal in enumerate(cells):
            if is_equal is not None:
                text, colour = ("equal bits", GREEN) if is_equal else ("may differ", VERMILLION)
                axes.text(column, row, text, ha="center", va="center", color=colour)
        axes.axhline(row - 0.5, color=GREY, lw=0.5)
    note = "under the locked versions, and but for networks that are flagged; empty: the device is another one"
    axes.text(-1.15, len(equal) - 0.1, note, ha="left", va="center", color=GREY)
    return figure


PICTURES: dict[str, Callable[[], Figure]] = {
    "checked": checked,
    "gate": gate,
    "walls": walls,
    "question": question,
    "plugged": plugged,
    "numerics": numerics,
}


def _canvas(height: float, columns: int) -> Axes:
    """Begin a figure, in inches as high, with room for so many boxes of width 1 beside each other."""
    _, (axes,) = new_figure("double", height)
    axes.set(xlim=(-0.02, columns + (columns - 1) * _GAP + 0.02), ylim=(-0.05, height + 0.25))
    axes.axis("off")
    return axes


def _middle(place: int) -> float:
    return place * (1 + _GAP) + 0.5


def _row(axes: Axes, boxes: Sequence[Box], bottom: float, height: float, *, joined: bool = False) -> None:
    for place, box in enumerate(boxes):
        _box(axes, box, _middle(place) - 0.5, bottom, height)
        if joined and place:
            middle = bottom + height / 2
            _arrow(axes, (_middle(place) - 0.5 - _GAP, middle), (_middle(place) - 0.5, middle))


def _box(axes: Axes, box: Box, left: float, bottom: float, height: float) -> None:
    style = "round,pad=0,rounding_size=0.05"
    axes.add_patch(FancyBboxPatch((left, bottom), 1, height, boxstyle=style, fc="white", ec=box.colour, lw=1.2))
    axes.text(left + 0.5, bottom + height - 0.16, box.title, ha="center", va="center", weight="bold")
    axes.text(left + 0.5, bottom + (height - 0.26) / 2, box.text, ha="center", va="center")


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str = GREY) -> None:
    axes.add_patch(
        FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=8, color=colour, lw=1, shrinkA=0, shrinkB=0)
    )


def main(folder: str) -> None:
    """Draw all of them into a directory."""
    for name, picture in PICTURES.items():
        (Path(folder) / f"{name}.svg").write_bytes(render(picture(), ".svg"))


if __name__ == "__main__":
    main(sys.argv[1])
