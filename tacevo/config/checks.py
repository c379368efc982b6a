"""How a setting with an impossible value is refused."""

import math
from enum import Enum

from tacevo.errors import ConfigError


def require(holds: bool, key: str, expected: str, got: object) -> None:
    """Refuse an impossible value by the key that the user wrote."""
    if not holds:
        written = str(got) if isinstance(got, Enum) else repr(got)  # a choice, as the user writes it
        raise ConfigError(f"{key} needs {expected}; got {written}")


def is_positive(value: float) -> bool:
    """Tell whether a value is above 0 and finite."""
    return 0 < value < math.inf
