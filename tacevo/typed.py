"""JSON from outside, checked once and turned into records.

A record is a frozen dataclass that extends `tacevo.records.Record`: an unknown key, a key that comes twice, a number as
text, or NaN is an error. Ranges stand in the annotations, e.g. `Annotated[int, Ge(1)]`. What a record keeps as JSON is
`FreeJson`.
"""

import json
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, GetPydanticSchema, TypeAdapter, ValidationError
from pydantic_core import PydanticCustomError

from tacevo.errors import TacevoError
from tacevo.records import Json

T = TypeVar("T")


def _finite(value: Json) -> Json:
    """Return JSON as it is, unless a number is NaN or infinite, which Pydantic lets through."""
    try:
        json.dumps(value, allow_nan=False)
    except ValueError as error:
        raise PydanticCustomError("not_finite", "Input should be JSON of finite numbers") from error
    return value


#: Lets pydantic read anything where it stands beside a type; a rule of our own checks it.
UNTYPED = GetPydanticSchema(lambda _, handler: handler(Any))

#: JSON whose numbers something else checks. (Pydantic cannot build a type that holds itself.)
UncheckedJson = Annotated[Json, UNTYPED]

#: JSON in a record, of finite numbers.
FreeJson = Annotated[UncheckedJson, AfterValidator(_finite)]

#: The values that can stand at a key, by the type of pydantic's error.
_EXPECTED = {
    "missing": "a value",
    "extra_forbidden": "only keys of this version",
    "unexpected_keyword_argument": "only keys of this version",
    "json_invalid": "JSON",
    "int_type": "an integer",
    "int_from_float": "an integer",
    "float_type": "a number",
    "string_type": "text",
    "bool_type": "true or false",
    "tuple_type": "a list",
    "dict_type": "an object",
    "dataclass_type": "an object",
    "greater_than": "{number} above {gt}",
    "greater_than_equal": "{number} of at least {ge}",
    "less_than": "{number} below {lt}",
    "less_than_equal": "{number} of at most {le}",
}


def parse(kind: type[T], text: str | bytes, *, place: str, error: type[TacevoError], remedy: str = "") -> T:
    """Read a record of a class, or of a union of such, from JSON text in UTF-8.

    Raises:
        TacevoError: of the class `error`: the text does not hold such a record, or has a key of an object twice; it
            names the first key at fault, behind the `place` of the text, what can stand there, and what does.
    """
    record = _read(kind, text, place, error, remedy)
    try:  # it is JSON of a bounded depth, or could not have been read
        _KEYS.decode(text if isinstance(text, str) else text.decode())
    except ValueError as problem:
        expected = "JSON with each key of an object once"
        raise error(str(problem), place=place, expected=expected, remedy=remedy) from problem
    return record


def convert(kind: type[T], value: Json, *, place: str, error: type[TacevoError], remedy: str = "") -> T:
    """Turn JSON values that are read already into a record; arguments and errors are those of `parse`."""
    return _read(kind, json.dumps(value), place, error, remedy)


def _read(kind: type[T], text: str | bytes, place: str, error: type[TacevoError], remedy: str) -> T:
    try:
        record: T = _adapter(kind).validate_json(text, strict=True)
    except ValidationError as problem:
        raise error(**_explained(problem, place), remedy=remedy) from problem
    return record


def _check_keys(pairs: list[tuple[str, object]]) -> None:
    """Check the keys of one object; its values are not kept."""
    if len(dict(pairs)) == len(pairs):  # the loop takes five times as long
        return
    seen: set[str] = set()
    for name, _ in pairs:
        if name in seen:
            raise ValueError(f"{_brief(name)} a second time")
        seen.add(name)


#: Pydantic takes the last of two equal keys, and other readers the first: each could be shown what the other is not.
_KEYS = json.JSONDecoder(object_pairs_hook=_check_keys, parse_int=len, parse_float=len)


_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)  # building one costs more than using it


def _explained(problem: ValidationError, place: str) -> dict[str, str]:
    """Write the first problem of a text as the fields of an error."""
    first = problem.errors(include_url=False)[0]
    kind, context = first["type"], first.get("ctx", {})
    # pydantic begins so; and with the second, where a record's own `__post_init__` raised.
    said = first["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    words = _EXPECTED.get(kind) or said.replace("{", "{{").replace("}", "}}")
    named = f"{first['loc'][-1] if first['loc'] else ''}={_brief(first['input'])}"
    got = {
        "missing": "nothing",
        "extra_forbidden": named,
        "unexpected_keyword_argument": named,
        "json_invalid": str(context.get("error")),
    }.get(kind) or _brief(first["input"])
    key = ".".join(map(str, first["loc"]))
    limits = {name: f"{value:g}" if isinstance(value, float) else value for name, value in context.items()}
    number = "an integer" if any(isinstance(value, int) for value in limits.values()) else "a number"
    expected = words.format(**limits, number=number)
    return {"place": ", ".join(part for part in (place, key) if part), "expected": expected, "got": got}


def _brief(value: Any, limit: int = 80) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= limit else f"{text[: limit - 3]}..."
