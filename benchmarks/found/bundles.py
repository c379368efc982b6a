"""The published runs, opened once each."""

from functools import cache
from pathlib import Path

import tacevo

ROOT = Path(__file__).parents[2]

#: Where published runs and tables lie, and runs that had to make room: kept where the tests are, and read as well.
PLACES = ("cache/published", "tests/golden/bundles", "cache/tables")


def place_of(name: str) -> str | None:
    """Return where a run, sweep or table of this name lies in the checkout; None if it is not published."""
    places = (f"{place}/{name}.zip" for place in PLACES)
    return next((place for place in places if (ROOT / place).is_file()), None)


@cache
def opened(name: str) -> tacevo.Run | tacevo.Sweep:
    """Open a published run or sweep by its name."""
    return tacevo.open(ROOT / str(place_of(name)))


def sweep(name: str) -> tacevo.Sweep:
    """Open a published sweep."""
    found = opened(name)
    assert isinstance(found, tacevo.Sweep)
    return found


def run(name: str) -> tacevo.Run:
    """Open a published run."""
    found = opened(name)
    assert isinstance(found, tacevo.Run)
    return found
