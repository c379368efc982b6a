"""Promise: one thing is named in the singular, any other number of things in the plural."""

import pytest

from tacevo.text import counted


@pytest.mark.parametrize(("number", "words"), [(0, "0 answers"), (1, "1 answer"), (2, "2 answers"), (11, "11 answers")])
def test_noun_follows_its_number(number: int, words: str) -> None:
    """Only one is singular."""
    assert counted(number, "answer") == words
