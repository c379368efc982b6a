"""Promise: what an archive is worth once its elites were trained again stands beside what was recorded of it."""

from dataclasses import replace

import pandas as pd
import pytest
from hand_runs import elite
from studies import network

from analysis.studies.corrected import CORRECTED, correct
from analysis.studies.reestimates import Reestimates
from analysis.table import Percent
from analysis.tables.noise import corrected_table

#: The baseline, and two elites whose records of 0.25 and 0.5 other seeds bring to 1 and 0.6.
RECORDED = (1.0, 0.25, 0.5)
LOSSES = ((1.0, 1.0, 1.0), (3.0, 0.25, 1.0), (0.6, 0.5, 0.7))

ELITES = [elite("g01s00", niche=3, fitness=0.25), elite("g01s01", niche=7, fitness=0.5)]

SOURCES = {"g01s00": "a", "g01s01": "b", "g02s00": "b"}

AGAIN = Reestimates(
    name="noise2-seeds3-epochs5-00000000",
    networks=tuple(
        replace(network(f"variant {name}"), id=name, source=name, fitness=fitness)
        for name, fitness in zip(("baseline", "a", "b"), RECORDED, strict=True)
    ),
    estimates=LOSSES,
    epochs=5,
)


def corrected(*elites: object, again: Reestimates = AGAIN) -> pd.DataFrame:
    """Correct an archive of ten niches."""
    archives = correct([*ELITES, *elites], 10, SOURCES, again)  # type: ignore[list-item]
    assert archives is not None
    return archives


def test_figures_are_those_of_the_archive_filled_again() -> None:
    """By hand: qualities of 1 / 1.25 and 1 / 1.5 become 1 / 2 and 1 / 1.6; the best is another network."""
    before, after = corrected().itertuples()
    assert (before.coverage, before.best, before.best_id) == (0.2, 0.25, "g01s00")
    assert before.qd_score == pytest.approx(1 / 1.25 + 1 / 1.5)
    assert (after.coverage, after.best, after.best_id) == (0.2, 0.6, "g01s01")
    assert after.qd_score == pytest.approx(0.5 + 1 / 1.6)


def test_elite_that_a_seed_does_not_train_leaves_its_niche_empty() -> None:
    """Coverage falls by it, and the table names it."""
    again = replace(
        AGAIN,
        networks=AGAIN.networks[:2],
        estimates=LOSSES[:2],
        failed=AGAIN.networks[2:],
    )
    archives = corrected(again=again)
    assert tuple(archives.loc["reestimated", ["coverage", "qd_score", "lost"]]) == (0.1, 0.5, ("g01s01",))
    table = corrected_table(archives, again, "force")
    assert dict((row[0], row[1:]) for row in table.rows)["coverage"] == (Percent(0.2), Percent(0.1))
    assert "g01s01" in table.notes[-1]


def test_elites_of_one_source_have_one_estimate() -> None:
    """A network that holds two places was trained once."""
    assert corrected(elite("g02s00", niche=8, fitness=0.4)).qd_score["reestimated"] == pytest.approx(0.5 + 2 / 1.6)


def test_archive_that_was_trained_again_in_part_is_not_corrected() -> None:
    """Four elites of many say nothing of the others."""
    part = replace(AGAIN, networks=AGAIN.networks[:2], estimates=LOSSES[:2])
    assert correct(ELITES, 10, SOURCES, part) is None


def test_empty_archive_has_no_best() -> None:
    """There is nothing to correct, and nothing to fail on."""
    archives = correct([], 10, SOURCES, AGAIN)
    assert archives is not None
    assert archives.coverage.tolist() == archives.qd_score.tolist() == [0, 0]
    assert archives[["best", "best_id"]].isna().all(axis=None)
    assert {name: str(kind) for name, kind in archives.dtypes.items()} == CORRECTED
    assert [row[1:] for row in corrected_table(archives, AGAIN, "force").rows[2:]] == [(None, None)] * 2
