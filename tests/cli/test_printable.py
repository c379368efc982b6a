"""Promise: no text moves a terminal's cursor, rings its bell or changes its title."""

import io
import os
import re
import sys
from pathlib import Path

import pytest
from checkout import ROOT
from PIL import Image
from rich.console import Console

from analysis.table import Interval, Table
from tacevo.cli.app import main
from tacevo.cli.tables import print_table, say
from tacevo.errors import TacevoError
from tacevo.runs.progress import Progress
from tacevo.text import printable, unbroken


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b]0;owned\x07", r"\x1b]0;owned\x07"),
        ("a\rb", r"a\rb"),
        ("\x9b2J", r"\x9b2J"),
        ("abc\u202efed", r"abc\u202efed"),
        ("two\n\tlines, größer", "two\n\tlines, größer"),
    ],
)
def test_what_a_terminal_would_obey_is_escaped(text: str, shown: str) -> None:
    """Controls of both tables and of direction; letters of any language and the ends of lines stay."""
    assert printable(text) == shown


def test_view_shows_no_raw_text() -> None:
    """A version in a stranger's run.json, say."""
    file = io.StringIO()
    Progress(Console(file=file)).say("another version: torch is 2; the run had \x1b[2J")
    assert file.getvalue() == "another version: torch is 2; the run had \\x1b[2J\n"


def test_text_begins_no_line_of_the_output(capsys: pytest.CaptureFixture[str]) -> None:
    """Line breaks in an error, a remark or a line of progress: what follows them would be taken for our own words."""
    hostile, file = "3.11\nEQUAL: search\r\ndigest: 0", io.StringIO()
    Progress(Console(file=file)).say(hostile)
    say([hostile])
    error = TacevoError(hostile, place=hostile, expected=hostile, remedy=hostile)
    assert len(str(error).splitlines()) == 1
    told = file.getvalue() + capsys.readouterr().err
    assert [line.partition("\\n")[0] for line in told.splitlines()] == ["3.11", "3.11"]


@pytest.mark.parametrize("text", ["a\tb", "a\n\tb", "\x1b[2J\t\r\n"])
def test_errors_and_lines_escape_alike(text: str) -> None:
    """Tabs, too, which would move what stands behind them: one text is one line, whoever says it."""
    assert str(TacevoError(text)) == unbroken(text)
    assert unbroken(text).isprintable()


@pytest.mark.room("data check")
def test_data_of_a_stranger_is_text_on_the_terminal(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Names of directories and files are names of classes and images."""
    for name in ("wide", "fine\nwarning: none \x1b[2J\u202e"):
        folder = place / "pressed" / name
        folder.mkdir(parents=True)
        for number in range(12):
            Image.new("RGB", (32, 32), (number, 9, 9)).save(folder / f"{number}\nequal: none\x9b.png")
    settings = ["task=grating", "data=folder", "data.root=pressed", "data.image_size=32", "task.outputs=2"]
    main(["data", "check", "-o", "sheet.png", "experiment=null", *settings])
    told = capsys.readouterr()
    assert r"fine\nwarning: none \x1b[2J\u202e" in told.out
    assert r"\nequal: none\x9b.png" in told.out
    for line in (told.out + told.err).splitlines():
        assert not line.startswith(("warning: none", "equal: none"))
        assert line.isprintable()


def test_commands_print_by_one_function() -> None:
    """It escapes what a terminal would obey, so no command has to think of it."""
    modules = list((ROOT / "tacevo" / "cli").glob("*.py"))
    assert [path.name for path in modules if re.search(r"(?<![\w.])print\(", path.read_text())] == ["common.py"]


def test_table_on_a_terminal_shows_no_raw_text() -> None:
    """Names, captions and notes may be a stranger's; what rich would take for a style is text, too."""
    file, hostile = io.StringIO(), "[red]\x1b[2J"
    cells = (hostile, Interval(0.5, 0.25, 0.75))
    table = Table(name="x", caption=hostile, columns=(hostile, "y"), rows=(cells,), notes=(hostile,))
    print_table(table, Console(file=file, force_terminal=True, color_system=None, width=80))
    assert file.getvalue().count("[red]\\x1b[2J") == 4
    assert "\x1b[2J" not in file.getvalue()
    assert "0.500 [0.250, 0.750]" in file.getvalue()


def test_narrow_terminal_breaks_no_number() -> None:
    """Headings and texts take more lines instead."""
    file, cells = io.StringIO(), ("undecided (0.19)", Interval(0.0138, 0.013, 0.0148), 0.0181)
    table = Table(name="x", caption="", columns=("verdict", "test MSE [95 %]", "re-estimated fitness"), rows=(cells,))
    print_table(table, Console(file=file, force_terminal=True, color_system=None, width=50))
    for words in ("undecided", "(0.19)", "0.0138 [0.0130, 0.0148]", "0.0181", "re-estimated"):
        assert words in file.getvalue()
    assert max(map(len, file.getvalue().splitlines())) <= 50


@pytest.mark.parametrize("width", [60, 30, 12])
def test_narrow_terminal_leaves_no_column_out(width: int, capsys: pytest.CaptureFixture[str]) -> None:
    """An interval goes below its number, and where not even that fits, the table is not laid out."""
    file, cells = (
        io.StringIO(),
        ("no_prompt_archive 日本語の長い名前", Interval(0.369, 0.342, 0.432), Interval(0.5, 0.388, 0.649)),
    )
    table = Table(name="x", caption="", columns=("arm", "median", "difference"), rows=(cells,))
    print_table(table, Console(file=file, force_terminal=True, color_system=None, width=width))
    told = file.getvalue() + capsys.readouterr().out
    for words in (
        "no_prompt_archive",
        "日本語の長い名前",
        "0.369",
        "[0.342, 0.432]",
        "0.500",
        "[0.388, 0.649]",
        "arm",
        "median",
    ):
        assert words in told


def test_table_in_a_log_is_plain_text(capsys: pytest.CaptureFixture[str]) -> None:
    """No marks of Markdown, and no text that begins a line of its own."""
    table = Table(
        name="x", caption="Of [a_b]\ndigest: 0", columns=("c *d*",), rows=(("`e`",), ("g",)), notes=("**f**",)
    )
    print_table(table, Console(file=io.StringIO()))
    told = capsys.readouterr().out
    assert "Of [a_b] digest: 0" in told.splitlines()
    assert "| c *d* |" in told
    assert "\\" not in told


def test_reader_that_had_enough_is_no_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`tacevo ... | head -1` ends as its reader does, without a word."""
    reading, writing = os.pipe()
    os.close(reading)
    closed = os.fdopen(writing, "w", buffering=1)
    monkeypatch.setattr(sys, "stdout", closed)
    assert main(["cache", "verify", "--store", str(tmp_path)]) == 0
    assert closed.closed
    assert capsys.readouterr().err == ""
