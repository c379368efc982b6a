"""What each key takes can be said in words, for every key there is."""

import pytest

from tacevo.config.keys import expected, keys


@pytest.mark.parametrize("key", keys())
def test_every_key_has_words(key: str) -> None:
    """No setting is of a type that the messages cannot describe."""
    assert expected(key)


@pytest.mark.parametrize("key", ["sed", "archive.bin", "seed.x", "archive.niches.x", ""])
def test_what_is_no_key_has_none(key: str) -> None:
    """Neither a misspelt key nor what seems to lie below a plain one is described."""
    assert expected(key) is None


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("data.image_size", "a whole number"),
        ("llm.top_p", "a number or null"),
        ("llm.mode", "one of live, record, replay"),
        ("data.target_columns", "a list in brackets, each item a text"),
        ("search", "its settings one by one, e.g. search.generations=VALUE"),
    ],
)
def test_types_are_told_as_a_user_thinks_of_them(key: str, words: str) -> None:
    """No name of a Python type, and the members of a choice as they are written."""
    assert expected(key) == words
