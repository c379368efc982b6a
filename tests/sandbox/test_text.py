"""Promise: text that came from a candidate is one short printable line before anyone sees it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacevo.sandbox.protocol import LONGEST, describe, one_line


@given(st.text())
def test_any_text_becomes_one_printable_line(text: str) -> None:
    """No control character reaches a terminal, and nothing is endless."""
    line = one_line(text)
    assert line.isprintable()
    assert len(line) <= LONGEST


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("\n  \n mat1 and mat2\nhave shapes", "mat1 and mat2"),
        ("<Net at 0x7f3a> lacks x", "<Net at 0x...> lacks x"),  # addresses differ between two runs
        ("mat1 of 1x30400 and mat2 of 30400x64", "mat1 of 1x30400 and mat2 of 30400x64"),  # and these are shapes
    ],
)
def test_first_line_is_kept_without_addresses(text: str, line: str) -> None:
    """The first that says something."""
    assert one_line(text) == line


class _MuteError(Exception):
    def __str__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ValueError("bad shape\nmore"), "ValueError: bad shape"),
        (ValueError(), "ValueError"),
        (_MuteError(), "_MuteError: (its message cannot be read)"),
    ],
)
def test_exception_is_its_type_and_message(error: Exception, line: str) -> None:
    """Also where its class is hostile."""
    assert describe(error) == line


def test_directories_of_modules_are_scrubbed() -> None:
    """An error of an import says which file of which module, and not where this machine has it."""
    with pytest.raises(ImportError) as raised:
        exec("from numpy.linalg import nonexistent")
    assert describe(raised.value).endswith("from 'numpy.linalg' (numpy/linalg/__init__.py)")
