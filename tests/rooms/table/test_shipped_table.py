"""Promise: the table that comes with the project is whole, and says what docs/table.md says of it."""

import re

import pytest
from checkout import ROOT

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


def test_page_says_what_a_fitness_is_worth(table: SpaceTable) -> None:
    """ICC and tau, of the last and of the lowest loss, as they are computed now."""
    worth = table.worth.set_index(["epochs", "rule"])
    shown = re.findall(r"^\| (\d+) \| (0\.\d\d) \| (0\.\d\d) \| (0\.\d\d) \| (0\.\d\d) \|$", PAGE, re.MULTILINE)
    assert len(shown) == 5
    for epochs, *figures in shown:
        pairs = [(value, rule) for value in ("icc", "one_seed") for rule in ("last", "lowest")]
        assert figures == [f"{worth.loc[(int(epochs), rule), value]:.2f}" for value, rule in pairs]


def test_page_says_how_good_networks_are(table: SpaceTable) -> None:
    """By their mean test loss over the seeds; the baseline is the first row."""
    losses = table.scores.groupby("network")["cross_entropy"].mean()
    least, most = f"{losses.min():.3f}", f"{losses.max():.3f}"
    middle = (
        f"median {losses.median():.3f}, baseline {losses.loc[0]:.3f}, trivial {read_table(TABLE).header.trivial:.2f}"
    )
    assert f"{least} to {most}, {middle}" in PAGE.replace("\n", " ")
