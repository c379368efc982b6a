"""Promise: what is sealed is what a reader accepts."""

import pytest
from refusals import refused

from tacevo.bundles.format import sealed
from tacevo.errors import RunError


@pytest.mark.parametrize(
    "name",
    [
        "tables/größe.csv",
        "tables/a b.csv",
        "notes.txt",
        "run/candidates/x.py",
        "../x",
        "sweep/a b/run.json",
        "sweep/sweep.json/run.json",
    ],
)
def test_strange_member_is_not_published(name: str) -> None:
    """What no reader would accept is not written."""
    with refused(RunError, expected="names with the letters", got=repr(name)):
        sealed({name: b""})
