"""Promise: what the same networks give under other seeds stands beside what was recorded of them."""

from dataclasses import replace

import numpy as np
import pytest
from studies import LOSSES, reestimates

from analysis.statistics.seed_noise import agreement, icc, worth
from analysis.studies.reestimates import Curves
from analysis.table import Interval
from analysis.tables.noise import noise_table, noise_tables


def test_record_stands_beside_its_re_estimates() -> None:
    """One row a network, with its candidate; the baseline does not beat itself."""
    table = noise_table(reestimates(), "force", None)
    baseline, winner = (dict(zip(table.columns, row, strict=True)) for row in table.rows)
    assert (winner["network"], winner["candidate"], winner["recorded fitness"]) == ("variant 1", "g01s00", 0.4)
    assert (winner["re-estimated, median"], winner["least"], winner["most"]) == (0.8, 0.7, 0.9)
    assert (winner["seeds as low as recorded"], winner["recorded less re-estimated"]) == (0, -0.4)
    assert isinstance(winner["chance to beat the baseline"], Interval)
    assert winner["chance to beat the baseline"].estimate == pytest.approx(0.5 / 9, abs=1e-9)
    assert baseline["chance to beat the baseline"] is None


def test_one_network_has_a_table_without_an_icc() -> None:
    """The note says what it would take."""
    alone = reestimates(LOSSES[:1])
    (table,) = noise_tables(alone, "force", None)
    assert any(note.startswith("No ICC") for note in table.notes)
    assert not any("Kendall" in note for note in table.notes)
    assert table.rows[0][table.columns.index("expected by regression")] is None


def test_ranking_shows_the_search_s_epoch_and_the_last() -> None:
    """Among doublings of 1; every other epoch is left out."""
    rng = np.random.default_rng(0)
    losses, scores = rng.random((2, 4, 11)), rng.random((2, 4))
    again = replace(reestimates(), curves=Curves(losses=losses, fitness=losses, tested=scores))
    _, table, _ = noise_tables(again, "force", None)
    assert [row[0] for row in table.rows] == [1, 2, 4, 5, 8, 11]


def test_each_rule_is_judged_by_its_own_fitness() -> None:
    """Curves whose lowest loss tells the networks apart, whose last loss is noise, and whose last three lie between."""
    rng = np.random.default_rng(0)
    levels = np.arange(1.0, 5.0)[:, None]
    lowest = levels * np.exp(0.01 * rng.normal(size=(4, 6)))
    middle = levels * np.exp(0.3 * rng.normal(size=(4, 6)))
    last = 9 * np.exp(rng.normal(size=(4, 6)))
    losses = np.stack([lowest, middle + 9, 2 * middle + 9, last + 9], axis=2)
    worths = worth(losses, np.broadcast_to(levels, (4, 6)))
    assert worths is not None
    rows = worths.set_index("rule")
    for rule, fitness in (("last", last + 9), ("lowest", lowest), ("mean_of_3", losses[:, :, 1:].mean(axis=2))):
        part, alone = icc(fitness), agreement(np.median(fitness[:, ::2], axis=1), levels[:, 0])
        assert part is not None
        assert (rows.icc[rule], rows.icc_low[rule], rows.icc_high[rule]) == pytest.approx(
            (part.estimate, part.low, part.high), rel=1e-6
        )
        assert rows["median"][rule] == alone
    assert rows.one_seed["lowest"] == 1 > rows.one_seed["last"]
    assert rows.icc["lowest"] > 0.9
    assert rows.icc["last"] < 0.5
    curves = Curves(losses=losses, fitness=losses, tested=levels + np.zeros(6))
    table = noise_tables(replace(reestimates(), curves=curves), "force", None)[2]
    assert [row[0] for row in table.rows] == ["last", "lowest", "mean_of_3"]
