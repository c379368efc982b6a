"""Promise: no text moves a terminal's cursor, rings its bell or changes its title."""

import io

import pytest
from rich.console import Console

from tacevo.runs.progress import Progress
from tacevo.text import printable


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
