"""Promise: the table that comes with the project is whole, and says what docs/table.md says of it."""

import re

import pytest
from checkout import ROOT

from benchmarks.judging import Space
from benchmarks.space import figures, judged, worths
from tacevo.api.space_tables import SpaceTable, open_table
from tacevo.reproduce.space_table import verify_table
from tacevo.results.space_table import read_table

TABLE = ROOT / "cache" / "tables" / "grating-space.zip"
PAGE = (ROOT / "docs" / "table.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def table() -> SpaceTable:
    """Open it."""
    return open_table(TABLE)


def test_table_is_that_of_its_page(table: SpaceTable) -> None:
    """Every network follows from its genome; all were trained, and the file stays small."""
    rows = read_table(TABLE)
    verify_table(rows)
    assert (rows.failures, rows.header.made_up, TABLE.stat().st_size < 5_000_000) == ([], False, True)
    assert f"{rows.name}\n" in PAGE
    assert f"digest: {table.digest}\n" in PAGE


def test_page_says_what_a_fitness_is_worth() -> None:
    """ICC and tau, of the last and of the lowest loss, in the whole space and the good quarter, as computed now."""
    rows = [*worths(Space(read_table(TABLE)))]
    assert len(rows) == 5
    assert "\n".join(rows) in PAGE


def test_page_says_what_the_judge_says(table: SpaceTable) -> None:
    """ICC and tau among its networks by its fresh seeds; their level, their deviations, and how sure it is of them."""
    *said, first, second, third, fourth, last = judged(Space(read_table(TABLE)))
    assert "\n".join((first, second, third, fourth, last)) in PAGE
    worth = table.worth.set_index(["epochs", "rule"])
    assert set(worth["judged_by"]) == {"fresh"}
    assert fourth.split(" | ")[2] == f"{worth.loc[(10, 'lowest'), 'icc']:.2f}"
    words = "\n".join(said)
    for pattern, shown in (
        (r"(\d+) networks", "has the {} networks that a model"),
        (r"between networks 0\.0(\d)", "networks deviate by {} %"),
        (r"between seeds 0\.(\d\d)", "seeds by {} %"),
        (r"ICC of a test loss (\S+ \[.*\])", "ICC of a test loss is {}"),
        (r"reliability of a mean of 5 seeds (0\.\d\d)", "fresh seeds has a reliability of {}"),
        (r"judged by that one: (0\.\d{3})", "put first has {} by the fifth"),
        (r"geometric mean (0\.\d{3})", "all 96 have {}"),
    ):
        _check_said(words, pattern, shown)


def test_page_says_what_two_genes_explain() -> None:
    """And how little is left among the networks that have both, as `benchmarks.space` prints it."""
    said = "\n".join(figures(Space(read_table(TABLE))))
    for pattern, shown in (
        (r"two genes explain 0\.(\d\d)", "explain {} %"),
        (r"max, batch (0\.\d{3})", "means {} with both"),
        (r"(\d+ of the best 38)", "holds {}"),
        (r"among these (0\.\d\d)", "ICC of a test loss is {}"),
        (r"reliability of a mean of 3 seeds (0\.\d\d)", "reliability of {}"),
        (r"of all: (0\.\d{3})", "first has {} by that one"),
        (r"last tenth of their epochs: (\d+)%", "{} % of the trainings"),
    ):
        _check_said(said, pattern, shown)


def test_page_says_how_good_networks_are(table: SpaceTable) -> None:
    """By their mean test loss over the seeds; the baseline is the first row."""
    losses = table.scores.groupby("network")["cross_entropy"].mean()
    least, most = f"{losses.min():.3f}", f"{losses.max():.3f}"
    middle = (
        f"median {losses.median():.3f}, baseline {losses.loc[0]:.3f}, trivial {read_table(TABLE).header.trivial:.2f}"
    )
    assert f"{least} to {most}, {middle}" in PAGE.replace("\n", " ")


def _check_said(said: str, pattern: str, shown: str) -> None:
    """Check that the page shows the figure that a pattern finds in what was computed now."""
    found = re.search(pattern, said)
    assert found is not None, pattern
    assert shown.format(found[1]) in PAGE.replace("\n", " "), shown
