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


def test_first_line_that_says_something_is_kept() -> None:
    """Blank lines in front are skipped, lines behind are cut."""
    assert one_line("\n  \n mat1 and mat2\nhave shapes") == "mat1 and mat2"


def test_addresses_are_scrubbed() -> None:
    """What differs between two runs is taken out."""
    assert one_line("<Net at 0x7f3a> lacks x") == "<Net at 0x...> lacks x"


def test_shapes_are_kept() -> None:
    """A matrix of 30400x64 is not an address."""
    assert one_line("mat1 of 1x30400 and mat2 of 30400x64") == "mat1 of 1x30400 and mat2 of 30400x64"


def test_exception_is_its_type_and_message() -> None:
    """A detail starts with the type, which says most."""
    assert describe(ValueError("bad shape\nmore")) == "ValueError: bad shape"
    assert describe(ValueError()) == "ValueError"


def test_exception_that_cannot_be_printed_is_described() -> None:
    """A hostile exception class does not break the report of it."""

    class _MuteError(Exception):
        def __str__(self) -> str:
            raise RuntimeError

    assert describe(_MuteError()) == "_MuteError: (its message cannot be read)"


def test_directories_of_modules_are_scrubbed() -> None:
    """An error of an import says which file of which module, and not where this machine has it."""
    with pytest.raises(ImportError) as raised:
        exec("from numpy.linalg import nonexistent")
    assert describe(raised.value).endswith("from 'numpy.linalg' (numpy/linalg/__init__.py)")
