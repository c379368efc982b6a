"""Promise: what somebody's output adds stands beside ours; what it raises is told with its line, and loses nothing."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from checkout import PUBLISHED, ROOT
from rooms import Ended, run_without

from tacevo.parts.output import Section

RUN = PUBLISHED / "force-variants.zip"

SWEEP = ROOT / "examples" / "lexicase.zip"

#: The outputs of a package. Their methods are those of `Output` that `given` names; each has a body of its own.
HEAD = """\
from analysis.table import Table
from tacevo.parts.output import Output, Section

def table(name, cell=1):
    return Table(name=name, caption="Made.", columns=("number",), rows=((cell,),))

def picture(name, draw=None):
    from analysis.figures.style import new_figure
    from analysis.report.figure_list import Picture
    return Picture(name=name, caption="Made.", draw=draw or (lambda: new_figure("single", 1.0)[0]))

def broken():
    raise KeyError("lost")

"""

MADE = """\
class Made(Output):
    def tables(self, run, profiles):
        return [table("widths")]
    def figures(self, run):
        return [picture("heights")]
    def section(self, run):
        return Section(title="</script><b>Mine", sentences=["<img src=x>"], figures=[picture("a")], tables=[table("b")])
    def sweep_tables(self, sweep):
        return [table("arms", len(sweep.sweep.finished))]
    def sweep_figures(self, sweep):
        return [picture("seeds")]
    def sweep_section(self, sweep):
        return Section(title="Of the sweep", tables=[table("c")])
"""


def package(folder: Path, body: str) -> Path:
    """Write a package with an output for each class of the body, as an installer lays it down."""
    (folder / "brash.py").write_text(HEAD + body)
    info = folder / "brash-2.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: brash\nVersion: 2.0\n")
    names = re.findall(r"class (\w+)\(Output", body)
    points = "\n".join(f"{name.lower()} = brash:{name}" for name in names)
    (info / "entry_points.txt").write_text(f"[tacevo.outputs]\n{points}\n")
    return folder


def commands(folder: Path, body: str, *lines: str) -> list[Ended]:
    """Run commands where the outputs of this body are installed."""
    installed = folder / "installed"
    installed.mkdir()
    return run_without("", lines, folder / "none", folder, installed=[package(installed, body)])


def page_of(file: Path) -> dict[str, Any]:
    """Return what a page holds."""
    (text,) = re.findall(r'<script type="application/json" id="contents">(.*?)</script>', file.read_text())
    page: dict[str, Any] = json.loads(text)
    return page


FAULTS = {
    "raises": ("raise ValueError('no such width')", "ValueError: no such width, brash.py, line {}"),
    "ends the process": ("raise SystemExit(3)", "SystemExit: 3, brash.py, line {}"),
    "lacks a library": ("import no_such_library", "no module no_such_library"),
    "returns another thing": ("return 7", "7"),
}

METHODS = {
    "tables": "run, profiles",
    "figures": "run",
    "section": "run",
    "sweep_tables": "sweep",
    "sweep_figures": "sweep",
    "sweep_section": "sweep",
}

#: What is returned that cannot be written, by method.
UNFIT = {
    "tables": ["[table('gate')]", "[table('../up')]", "[table('a'), table('a')]", "[table('a', object)]", "['a']"],
    "figures": ["[picture('fitness')]", "[picture('a', broken)]", "[picture('a', lambda: 7)]", "[picture('/a')]"],
    "section": [
        "Section(title=' ')",
        "Section(title='a', sentences='b')",
        "Section(title='a', tables=['b'])",
        "Section(title='a', figures=[picture('b', broken)])",
        "Section(title='a', tables=[Table(name='b', caption=object, columns=(), rows=())])",
    ],
}


def _classes() -> str:
    """Return outputs of which each has one fault, and a good one behind them."""
    bodies = [(method, fault) for method in METHODS for fault, _ in FAULTS.values()]
    bodies += [(method, f"return {value}") for method, values in UNFIT.items() for value in values]
    bodies += [(f"sweep_{method}", f"return {value}") for method, values in UNFIT.items() for value in values[1:]]
    return "".join(
        f"class C{number:02d}(Output):\n    def {method}(self, {METHODS[method]}):\n        {body}\n"
        for number, (method, body) in enumerate(bodies)
    )


def test_what_an_output_raises_is_told_with_its_line_and_loses_nothing(tmp_path: Path) -> None:
    """Of every method, whatever it raises or returns: all that ours and a good one make is there, and each is named.

    What the good one makes is written by the commands that write ours; its texts are data in the page.
    """
    body = _classes() + MADE
    ended = commands(
        tmp_path,
        body,
        f"tables {RUN} --output tables",
        f"figures {RUN} --output figures --format svg",
        f"report {RUN} --output run.html",
        f"ablations {SWEEP} --output arms",
        f"report {SWEEP} --output sweep.html",
    )
    assert [status for status, _, _ in ended] == [0] * 5, [said for status, _, said in ended if status]
    told = "".join(said for _, _, said in ended)
    for number, line in enumerate(re.findall(r"class C\d+\(Output\):\n.+\n +(.+)\n", body)):
        (said, *_) = re.findall(rf"^no .+ of c{number:02d}(?: .+|: .+)$", told, re.MULTILINE)
        for fault, expected in FAULTS.values():
            if line == fault:
                assert expected.format(_line_of(body, number)) in said
    names = {path.stem for path in (tmp_path / "tables").rglob("*.csv")}
    assert {"widths", "gate", "improvement", "niches"} <= names
    assert (tmp_path / "tables/gate.csv").read_text().count("\n") > 2
    assert not list(tmp_path.rglob("up.csv"))
    assert {path.stem for path in (tmp_path / "figures").glob("*.svg")} >= {"heights", "fitness", "lineage"}
    assert {path.stem for path in (tmp_path / "arms").glob("*.pdf")} >= {"seeds", "ablation_curves"}
    assert (tmp_path / "tables/more/widths.csv").read_text() == "number\n1\n"
    assert (tmp_path / "arms/more/arms.csv").read_text() == "number\n4\n"
    section = page_of(tmp_path / "run.html")["runs"][0]["sections"][-1]
    assert (section["title"], section["sentences"]) == ("</script><b>Mine", ["<img src=x>"])
    assert (section["by"], section["tables"][0]["rows"]) == ("made, brash 2.0", [["1"]])
    assert section["figures"][0]["image"].startswith("data:image/png;base64,")
    assert "<b>Mine" not in (tmp_path / "run.html").read_text()
    assert page_of(tmp_path / "sweep.html")["sweep"]["sections"][-1]["title"] == "Of the sweep"


def _line_of(body: str, number: int) -> int:
    """Return the number of the line that is the body of a method of a class."""
    return (HEAD + body).split("\n").index(f"class C{number:02d}(Output):") + 3


def test_replay_of_a_bundle_runs_no_output_that_is_installed(tmp_path: Path) -> None:
    """Its tables are those of ours, which anybody can make; nothing of the package is imported."""
    body = MADE + f"open({str(tmp_path / 'imported')!r}, 'w')\n"
    for status, printed, _ in commands(tmp_path, body, f"replay {RUN}", f"replay {SWEEP}"):
        assert status == 0
        assert "EQUAL: " in printed
    assert not (tmp_path / "imported").exists()


@pytest.mark.parametrize(
    "wrong",
    [{"title": ""}, {"title": 3}, {"title": "a", "sentences": "a"}, {"title": "a", "sentences": [1]}],
    ids=str,
)
def test_section_refuses_what_is_no_text(wrong: dict[str, Any]) -> None:
    """Where it is made."""
    with pytest.raises(TypeError):
        Section(**wrong)
