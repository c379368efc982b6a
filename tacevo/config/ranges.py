"""The kinds of values that settings take; an error names a kind in the words that stand here."""

import re
from collections.abc import Callable
from typing import Annotated, Any

from annotated_types import Ge, Gt, Le
from pydantic import AfterValidator
from pydantic_core import PydanticCustomError


def is_a(words: str, holds: Callable[[Any], object]) -> AfterValidator:
    """Make the rule that a value is what the words say."""

    def check(value: Any) -> Any:
        if not holds(value):
            raise PydanticCustomError("misfit", "Input should be {words}", {"words": words})
        return value

    return AfterValidator(check)


Natural = Annotated[int, Ge(0)]
Count = Annotated[int, Ge(1)]
Memory = Annotated[int, Ge(64)]
Positive = Annotated[float, Gt(0)]
Fraction = Annotated[float, Ge(0), Le(1)]
Text = Annotated[str, is_a("text that is not empty", bool)]
Name = Annotated[str, is_a("letters, digits, _ and -", re.compile(r"[\w-]+").fullmatch)]
Identifier = Annotated[str, is_a("a name that Python allows", str.isidentifier)]
