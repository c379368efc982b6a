"""JSON from outside becomes records, or an error that names the key."""

from dataclasses import dataclass
from typing import Annotated

import pytest
from annotated_types import Ge
from refusals import refused

from tacevo.errors import RunError
from tacevo.records import STRICT, Kind
from tacevo.typed import FreeJson, UncheckedJson, _check_keys, convert, parse


@dataclass(frozen=True, slots=True, kw_only=True)
class Inner:
    """A record in a record."""

    __pydantic_config__ = STRICT

    count: Annotated[int, Ge(1)]
    kind: Kind


@dataclass(frozen=True, slots=True, kw_only=True)
class Outer:
    """What the tests read."""

    __pydantic_config__ = STRICT

    inner: tuple[Inner, ...]
    share: float = 1.0
    names: dict[str, str] | None = None
    free: FreeJson = None


def test_sound_text_becomes_a_record() -> None:
    """Lists become tuples, and words become enums."""
    text = '{"inner": [{"count": 2, "kind": "regression"}], "share": 0.5}'
    assert parse(Outer, text, place="f", error=RunError) == Outer(
        inner=(Inner(count=2, kind=Kind.regression),), share=0.5
    )


class Counted(str):
    """A key that counts how often it is compared."""

    __slots__ = ()
    __hash__ = str.__hash__
    compared = 0

    def __eq__(self, other: object) -> bool:
        Counted.compared += 1
        return str.__eq__(self, other)


def test_keys_are_checked_in_one_pass() -> None:
    """The key that comes twice is the last of many here; each of them is looked up once."""
    names = [Counted(number) for number in range(1000)]
    with pytest.raises(ValueError, match=r'^"999" a second time$'):
        _check_keys([*((name, None) for name in names), (Counted(999), None)])
    assert Counted.compared < 10


def test_values_become_a_record() -> None:
    """JSON that another reader has parsed goes the same way."""
    assert convert(Outer, {"inner": []}, place="f", error=RunError) == Outer(inner=())


@pytest.mark.parametrize(
    ("text", "place", "expected", "got"),
    [
        ('{"inner": [{"count": 0, "kind": "regression"}]}', "f, inner.0.count", "an integer of at least 1", "0"),
        ('{"inner": [{"count": "1", "kind": "regression"}]}', "f, inner.0.count", "an integer", '"1"'),
        ('{"inner": [{"count": true, "kind": "regression"}]}', "f, inner.0.count", "an integer", "true"),
        ('{"inner": [{"count": 1, "kind": "x"}]}', "f, inner.0.kind", "'regression' or 'classification'", '"x"'),
        ('{"inner": [{"kind": "regression"}]}', "f, inner.0.count", "a value", "nothing"),
        ('{"inner": [], "other": 1}', "f, other", "only keys of this version", "other=1"),
        ('{"inner": [], "share": NaN}', "f, share", "finite number", "NaN"),
        ('{"inner": [], "free": {"a": [1, NaN]}}', "f, free", "finite numbers", '{"a": [1, NaN]}'),
        ('{"inner": [], "free": -Infinity}', "f, free", "finite numbers", "-Infinity"),
        ('{"inner": [], "free": [1e999]}', "f, free", "finite numbers", "[Infinity]"),
        ('{"inner": [], "names": {"{a}": 1}}', "f, names.{a}", "text", "1"),
        ("{", "f", "JSON", "EOF"),
        ("[" * 100_000, "f", "JSON", "recursion"),
        ("3", "f", "an object", "3"),
        ('{"inner": "\\ud800"}', "f", "JSON", "escape"),
    ],
)
def test_unsound_text_is_an_error_at_its_key(text: str, place: str, expected: str, got: str) -> None:
    """Nothing is guessed, dropped or filled in."""
    with refused(RunError, place=place, expected=expected, got=got, remedy="restore f"):
        parse(Outer, text, place="f", error=RunError, remedy="restore f")


@pytest.mark.parametrize(
    "text",
    [
        '{"share": 0.1, "inner": [], "share": 0.5}',
        '{"share": 0.5, "inner": [], "share": 0.5}',
        '{"inner": [], "sh\\u0061re": 0.1, "share": 0.5}',
        '{"inner": [{"count": 1, "count": 2, "kind": "regression"}]}',
        '{"inner": [], "names": {"a": "1", "b": "2", "a": "1"}}',
        '{"inner": [], "free": [{"a": {"x": 1, "x": 2}}]}',
    ],
)
def test_key_that_comes_twice_is_refused(text: str) -> None:
    """At any depth and in any spelling: some readers take the first value, some the last."""
    for given in (text, text.encode()):
        with refused(
            RunError, place="f", expected="each key of an object once", got="a second time", remedy="restore it"
        ):
            parse(Outer, given, place="f", error=RunError, remedy="restore it")


def test_equal_keys_of_two_objects_are_no_fault() -> None:
    """Nor is a value that looks like a key, a number of many digits, or NaN where something else checks it."""
    text = '{"a": {"x": 1}, "b": {"x": 1}, "c": ["a", "a"], "d": ' + "9" * 4000 + ", " + '"e": NaN}'
    assert list(parse(dict[str, UncheckedJson], text, place="f", error=RunError)) == ["a", "b", "c", "d", "e"]
