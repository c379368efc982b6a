"""Draw the house: `python docs/site/house.py [FILE]` writes docs/figures/house.svg from the imports as they are now.

A room is a package, a floor a layer of pyproject.toml; a room may import the floors below its own. A line joins two
rooms of which the upper one imports the lower one; it is left out where other lines lead there, too. The numbers are
the way of one candidate, from the command to the ledger, and docs/design.md has the list of them.
"""

import sys
import tomllib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import grimp
import matplotlib as mpl
from costs import statements
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

ROOT = Path(__file__).resolve().parents[2]

FILE = ROOT / "docs/figures/house.svg"

#: Where a candidate comes from and where it goes, in the order in which it meets the rooms: what happens there, and the
#: file to open.
WAY = (
    ("cli", "a command is typed", "tacevo/cli/search.py"),
    ("config", "its settings are composed and checked", "tacevo/config/compose.py"),
    ("runs", "one run is put together", "tacevo/runs/wiring.py"),
    ("evolution", "parents, an instruction and a temperature are drawn", "tacevo/evolution/algorithm.py"),
    ("llm", "a model answers", "tacevo/llm/recording.py"),
    ("gate", "the answer becomes a class that may run", "tacevo/gate/admission.py"),
    ("sandbox", "a confined process is started for it", "tacevo/sandbox/client.py"),
    ("training", "it is trained there", "tacevo/training/evaluation.py"),
    ("data", "on these images", "tacevo/data/loading.py"),
    ("storage", "its answers are stored, and its line is added to the ledger", "tacevo/storage/ledger.py"),
)

#: What is in a room, in two lines.
HOLDS = {
    "cli": "the commands\nthat a user types",
    "api": "the same\nfrom Python",
    "bundles": "runs published\nas one file",
    "export": "a network\ntaken away",
    "reproduce": "replay, retrain\nand compare",
    "studies": "full trainings\nof the best",
    "sweeps": "many searches",
    "runs": "one run, built\nfrom its settings",
    "cluster": "the nodes\nof a Ray cluster",
    "tracking": "the mirror\nin MLflow",
    "results": "finished runs,\nread and checked",
    "config": "settings, composed\nand checked",
    "llm": "models that\nanswer requests",
    "gate": "what may run,\nand what may not",
    "training": "epochs, losses,\nequal bits",
    "data": "images and labels",
    "evolution": "Algorithm 1\nof the paper",
    "sandbox": "confined processes",
    "storage": "stores, ledgers\nand directories",
}

#: Modules that every room may import, which would be lines everywhere.
_EVERYWHERE = "below all"

_INK, _LINE, _ROOM, _BASE, _STEP = "#22303c", "#7a8b99", "#e8eef3", "#f6f1e4", "#b4532a"

#: In inches: height of a room and of the space below it, width of a room and of the space beside it, width of the page.
_HEIGHT, _BETWEEN, _WIDE, _GAP, _PAGE = 0.74, 0.3, 1.85, 0.3, 10.9

#: Where rooms stand that would else hide a line, from the middle of the page, in inches.
_ASIDE = {
    "api": -2.2,
    "bundles": -3.3,
    "export": -1.1,
    "reproduce": -2.2,
    "studies": -2.2,
    "sweeps": 0.0,
    "runs": -0.5,
    "cluster": 2.62,
    "tracking": 4.5,
    "evolution": -4.3,
    "sandbox": 0.0,
    "storage": 2.15,
}


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


def nearest(pairs: Collection[tuple[str, str]]) -> set[tuple[str, str]]:
    """Leave out each import of a room that the same room also reaches through others."""
    below: dict[str, set[str]] = {}

    def reached(room: str) -> set[str]:
        if room not in below:
            own = {there for here, there in pairs if here == room}
            below[room] = own.union(*map(reached, own))
        return below[room]

    return {
        (here, there)
        for here, there in pairs
        if not any(there in reached(other) for start, other in pairs if start == here)
    }


def draw() -> Figure:
    """Draw rooms, imports and the way of a candidate."""
    floors, counts = rows(), sizes()
    height = len(floors) * (_HEIGHT + _BETWEEN)
    figure = Figure(figsize=(_PAGE, height + 0.1))
    axes = figure.add_axes((0, 0, 1, 1))
    places = dict(_places(floors))
    for here, there in sorted(nearest(imports())):
        (x, y), (u, v) = places[here], places[there]
        ends = (x + _WIDE / 2, u + _WIDE / 2), (y, v + _HEIGHT)
        axes.plot(*ends, color=_LINE, linewidth=1.1, alpha=0.75, zorder=1, solid_capstyle="round")
    for room, (x, y) in places.items():
        words = ("every room may import: records, errors, rules, text, parts", "") if room == _EVERYWHERE else None
        _draw_room(axes, (x, y), words or (room, HOLDS[room]), counts[room])
    for number, (room, *_) in enumerate(WAY, start=1):
        x, y = places[room]
        step = axes.text(x, y + _HEIGHT, str(number), ha="center", va="center", color="white", fontsize=10, zorder=4)
        step.set_bbox({"boxstyle": "circle,pad=0.25", "facecolor": _STEP, "edgecolor": "none"})
    axes.set(xlim=(0, _PAGE), ylim=(-0.05, height + 0.05))
    axes.axis("off")
    return figure


def _draw_room(axes: mpl.axes.Axes, corner: tuple[float, float], words: tuple[str, str], count: int) -> None:
    """Draw a box with the name of a room, what it holds, and its statements."""
    (x, y), (name, holds) = corner, words
    width, colour = (_WIDE, _ROOM) if holds else (_PAGE - 2 * _GAP, _BASE)
    box = FancyBboxPatch((x, y), width, _HEIGHT, "round,pad=0,rounding_size=0.08", facecolor=colour, zorder=2)
    box.set(edgecolor=_INK, linewidth=0.8)
    axes.add_patch(box)
    middle = x + width / 2
    at, weight = (0.78, "bold") if holds else (0.5, "normal")
    axes.text(
        middle, y + _HEIGHT * at, name, ha="center", va="center", color=_INK, fontsize=11, weight=weight, zorder=3
    )
    axes.text(middle, y + _HEIGHT * 0.35, holds, ha="center", va="center", color=_INK, fontsize=9, zorder=3)
    axes.text(x + width - 0.06, y + 0.05, f"{count:,}", ha="right", va="bottom", color=_LINE, fontsize=7, zorder=3)


def _places(floors: Sequence[Sequence[str]]) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield left and bottom of each room, the highest floor first."""
    for number, floor in enumerate(floors):
        y = (len(floors) - 1 - number) * (_HEIGHT + _BETWEEN)
        if floor == [_EVERYWHERE]:
            yield _EVERYWHERE, (_GAP, y)
            return
        for place, room in enumerate(floor):
            middle = _ASIDE.get(room, (place - (len(floor) - 1) / 2) * (_WIDE + _GAP))
            yield room, (_PAGE / 2 + middle - _WIDE / 2, y)


def write(path: Path) -> None:
    """Write the picture as SVG."""
    with mpl.rc_context({"svg.hashsalt": "house", "font.family": "DejaVu Sans", "svg.fonttype": "none"}):
        draw().savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else FILE)
