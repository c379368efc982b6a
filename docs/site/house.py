"""Draw the house: `python docs/site/house.py [FILE]` writes docs/figures/house.svg from the imports as they are now.

A room is a package, its width its statements; a row may import the rows below it (the layers of pyproject.toml). A line
joins two rooms of which one imports the other, the thicker the more modules do. The numbers are the way of one
candidate, from the command to the ledger.
"""

import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import grimp
import matplotlib as mpl
from costs import statements
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

ROOT = Path(__file__).resolve().parents[2]

FILE = ROOT / "docs/figures/house.svg"

#: Where a candidate comes from and where it goes, in the order in which it meets the rooms.
WAY = (
    ("cli", "a command is typed"),
    ("config", "its settings are composed and checked"),
    ("runs", "one run is put together"),
    ("evolution", "parents, instruction and temperature are drawn"),
    ("llm", "a model answers"),
    ("gate", "the answer becomes a class that may run"),
    ("sandbox", "a confined process is forked for it"),
    ("training", "it is trained there"),
    ("data", "on these images"),
    ("storage", "answer, probe and training are stored; its line is committed to the ledger"),
)

#: Modules that every room may import, which would be lines everywhere.
_EVERYWHERE = "below all"

_INK, _LINE, _ROOM, _BASE = "#22303c", "#7a8b99", "#e8eef3", "#f6f1e4"

_HEIGHT, _GAP, _LEAST, _WIDTH = 0.62, 0.16, 0.75, 11.0

#: Rows of fewer rooms stand aside by so much.
_FEW, _ASIDE = 3, 2.2


def rows() -> list[list[str]]:
    """Return the rooms of `tacevo` by row, the highest first, as the contract of imports has them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    (layers,) = (each["layers"] for each in settings["contracts"] if each.get("containers") == ["tacevo"])
    *floors, _ = ([name.strip() for name in layer.replace(":", "|").split("|")] for layer in layers)
    return [*floors, [_EVERYWHERE]]


def sizes() -> Mapping[str, int]:
    """Count the statements of each room, without docstrings."""
    known = {name for row in rows() for name in row}
    counts = Counter[str]()
    for path in (ROOT / "tacevo").rglob("*.py"):
        room = path.relative_to(ROOT / "tacevo").parts[0]
        counts[room if room in known else _EVERYWHERE] += statements([path])
    return counts


def imports() -> Mapping[tuple[str, str], int]:
    """Count the modules of a room that import some of another; what all may import is left out."""
    graph = grimp.build_graph("tacevo")
    known = {name for row in rows() for name in row}
    pairs = set[tuple[str, str, str]]()
    for importer in graph.modules:
        for imported in graph.find_modules_directly_imported_by(importer):
            here, there = _room(importer, known), _room(imported, known)
            if here != there and {here, there} <= known - {_EVERYWHERE}:
                pairs.add((here, there, importer))
    return Counter((here, there) for here, there, _ in pairs)


def _room(module: str, known: set[str]) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in known else _EVERYWHERE


def draw() -> Figure:
    """Draw rooms, imports and the way of a candidate."""
    floors, counts, joined = rows(), sizes(), imports()
    figure = Figure(figsize=(_WIDTH, 0.98 * len(floors) + 2.6))
    axes = figure.add_axes((0, 0, 1, 1))
    places = dict(_places(floors, counts))
    for (here, there), count in sorted(joined.items()):
        (x, y, width), (u, v, other) = places[here], places[there]
        ends = (x + width / 2, u + other / 2), (y, v + _HEIGHT)
        axes.plot(*ends, color=_LINE, linewidth=0.4 + 0.12 * count, alpha=0.35, zorder=1, solid_capstyle="round")
    steps = {room: str(number) for number, (room, _) in enumerate(WAY, start=1)}
    for room, (x, y, width) in places.items():
        colour = _BASE if room == _EVERYWHERE else _ROOM
        box = FancyBboxPatch((x, y), width, _HEIGHT, "round,pad=0,rounding_size=0.08", facecolor=colour, zorder=2)
        box.set(edgecolor=_INK, linewidth=0.8)
        axes.add_patch(box)
        words = "records, errors, rules, text, parts: what every room may import" if room == _EVERYWHERE else room
        axes.text(x + width / 2, y + _HEIGHT * 0.6, words, ha="center", va="center", color=_INK, fontsize=10, zorder=3)
        axes.text(
            x + width / 2,
            y + _HEIGHT * 0.2,
            f"{counts[room]:,}",
            ha="center",
            va="center",
            color=_LINE,
            fontsize=7,
            zorder=3,
        )
        if room in steps:
            axes.text(
                x, y + _HEIGHT, steps[room], ha="center", va="center", color="white", fontsize=8, zorder=4
            ).set_bbox({"boxstyle": "circle,pad=0.2", "facecolor": "#b4532a", "edgecolor": "none"})
    _legend(axes)
    axes.set(xlim=(-0.2, _WIDTH + 0.2), ylim=(-1.5, 0.98 * len(floors) + 0.1))
    axes.axis("off")
    return figure


def _places(
    floors: Sequence[Sequence[str]], sizes: Mapping[str, int]
) -> Iterator[tuple[str, tuple[float, float, float]]]:
    """Yield left, bottom and width of each room: wide ones have many statements, and a row stands in the middle."""
    unit = (_WIDTH - 5 * _GAP) / max(sum(sizes[room] for room in row) for row in floors)
    for number, row in enumerate(floors):
        widths = [max(_LEAST, unit * sizes[room]) for room in row]
        if row == [_EVERYWHERE]:
            yield _EVERYWHERE, (0, 0, _WIDTH)
            return
        left = (_WIDTH - sum(widths) - _GAP * (len(row) - 1)) / 2
        if len(row) < _FEW:  # by turns to one side and the other, so that lines do not hide each other
            left += _ASIDE if number % 2 else -_ASIDE
        for room, width in zip(row, widths, strict=True):
            yield room, (left, 0.98 * (len(floors) - 1 - number), width)
            left += width + _GAP


def _legend(axes: mpl.axes.Axes) -> None:
    """Write the way of a candidate below the house."""
    lines = [f"{number}  {room}: {does}" for number, (room, does) in enumerate(WAY, start=1)]
    for column, part in enumerate((lines[:5], lines[5:])):
        axes.text(0.1 + column * _WIDTH / 2, -0.25, "\n".join(part), ha="left", va="top", color=_INK, fontsize=8.5)


def write(path: Path) -> None:
    """Write the picture as SVG."""
    with mpl.rc_context({"svg.hashsalt": "house", "font.family": "DejaVu Sans", "svg.fonttype": "none"}):
        draw().savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else FILE)
