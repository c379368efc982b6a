"""Promise: a study is about the baseline and the best elites by validation loss, each source once."""

import pytest
from ledger_lines import rejected, trained
from refusals import refused

from tacevo.errors import RunError
from tacevo.studies.networks import networks_of

CANDIDATES = [
    trained("g00s00", 0.5, source="base"),
    trained("g00s01", 0.4, source="a"),
    trained("g01s00", 0.2, source="b"),
    trained("g01s01", 0.4, source="c"),
    trained("g01s02", 0.2, source="b"),
    trained("g01s03", 0.1, source="base"),
    rejected("g01s04", "probe", "crashed"),
]


def chosen(elites: list[str], count: int) -> list[tuple[str, str]]:
    """Give names and ids of the networks."""
    return [(network.name, network.id) for network in networks_of(CANDIDATES, elites, count)]


def test_best_elites_come_after_the_baseline() -> None:
    """Lowest validation loss first, the earlier id on a tie, as many as were asked for."""
    elites = ["g01s01", "g01s00", "g00s01"]
    expected = [
        ("baseline", "g00s00"),
        ("variant 1", "g01s00"),
        ("variant 2", "g00s01"),
        ("variant 3", "g01s01"),
    ]
    assert chosen(elites, 3) == expected
    assert chosen(elites, 2) == expected[:3]
    assert chosen(elites, 9) == expected


def test_equal_sources_count_once() -> None:
    """Neither the baseline as an elite, nor a copy of it or of a better elite, takes a place."""
    elites = ["g00s00", "g01s03", "g01s02", "g01s00", "g01s01"]
    assert chosen(elites, 2) == [("baseline", "g00s00"), ("variant 1", "g01s00"), ("variant 2", "g01s01")]


@pytest.mark.parametrize("name", ["g01s04", "g09s09"])
def test_elite_that_was_not_trained_is_refused(name: str) -> None:
    """An archive that names what the ledger does not have was edited."""
    with refused(RunError, got=f"{name} without a fitness", remedy="restore archive.json"):
        networks_of(CANDIDATES, [name], 1)
