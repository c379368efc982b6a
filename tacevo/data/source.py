"""The words in which sources of tactile images (`tacevo.parts.source`) report faults."""

from collections.abc import Hashable, Iterable, Sequence
from functools import partial

import tacevo.text
from tacevo.errors import DataError
from tacevo.records import Json

#: The number of faults that a message spells out before it only counts them.
SHOWN_FAULTS = 5

#: The number of names of columns, files or directories that a message lists, and of the characters of one text that it
#: shows.
SHOWN_NAMES, SHOWN_CHARACTERS = 10, 60


def chosen(source: object, *names: str) -> dict[str, Json]:
    """Return those of some settings that are set: they came later, and descriptions of earlier releases lack them."""
    return {name: value for name in names if (value := getattr(source, name)) is not None}


def check_no_faults(problem: str, faults: Sequence[str], remedy: str, *, place: str = "", expected: str = "") -> None:
    """Raise one error about all faults of one kind; do nothing without faults.

    The problem is, say, `labels.csv names images that do not exist`; of the faults, the first few are shown. Place and
    expected are those of the error.

    Raises:
        DataError: `faults` is not empty.
    """
    if not faults:
        return
    shown = ", ".join(faults[:SHOWN_FAULTS]) + (", ..." if len(faults) > SHOWN_FAULTS else "")
    raise DataError(f"{problem} ({len(faults)} found): {shown}", place=place, expected=expected, remedy=remedy)


def check_readable(errors: Sequence[tuple[str, DataError]]) -> None:
    """Raise one error about all images that cannot be read, each with what the user calls it.

    Raises:
        DataError: there are some; it has the remedies that they name.
    """
    remedies = sorted({error.remedy or "repair or remove them" for _, error in errors})
    faults = [f"{name} ({error.got})" for name, error in errors]
    check_no_faults("some images cannot be read", faults, ", or ".join(remedies))


def shortened(text: str) -> str:
    """Quote a text for a message, cut where it is long."""
    return repr(text if len(text) <= SHOWN_CHARACTERS else f"{text[: SHOWN_CHARACTERS - 3]}...")


#: Joins names for a message, the first few.
listed = partial(tacevo.text.listed, nothing="", most=SHOWN_NAMES)


def repeats(named: Iterable[tuple[str, Hashable]]) -> list[str]:
    """List the names of items whose key an earlier item has already."""
    seen: set[Hashable] = set()
    repeated = []
    for name, key in named:
        if key in seen:
            repeated.append(name)
        seen.add(key)
    return repeated
