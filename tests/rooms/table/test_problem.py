"""Promise: a table is a problem for any optimiser; genes find their network, and who chose does not judge."""

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checkout import ROOT
from made_up import TINY, made_up_table
from refusals import refused

import tacevo
from tacevo.api.space_problems import Evaluation, SpaceProblem
from tacevo.errors import BundleError, ConfigError
from tacevo.evolution.lines import training_flops
from tacevo.records import Reason, Rejection, Stage
from tacevo.results.space_table import read_table, write_table
from tacevo.results.table_records import SpaceTable
from tacevo.studies.tabulate import members
from tacevo.training.full import FullTraining

pytestmark = pytest.mark.room("table")


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> SpaceTable:
    """Make one of eight networks and the baseline; the third network fails."""
    place = tmp_path_factory.mktemp("problem") / "table.zip"
    return made_up_table(place, *TINY, "training.epochs=4", failing=3)


@pytest.fixture(scope="module")
def problem(table: SpaceTable) -> SpaceProblem:
    """Make a problem of it."""
    return tacevo.open_table(table.path).as_problem()


def genes_of(table: SpaceTable, row: int) -> dict[str, Any]:
    """Return the genes of a row."""
    return dict(table.networks[row].genome or {})


def full(table: SpaceTable, row: int, seed: int) -> FullTraining:
    """Return what a row recorded."""
    verdict = table.verdicts[row, seed]
    assert isinstance(verdict, FullTraining)
    return verdict


def test_genes_and_networks_of_the_shipped_table_are_one_to_one() -> None:
    """Each combination of choices is found once, and as the network that the space writes for it."""
    path = ROOT / "cache" / "tables" / "grating-space.zip"
    table, problem = read_table(path), tacevo.open_table(path).as_problem()
    written = [(genome, source) for genome, source in members(table.header.settings, table.header.task) if genome]
    found = set()
    for genome, source in written:
        row = table.by_source[source]
        for seed in range(problem.seeds):
            evaluation = problem.evaluate(genome, seed=seed, epochs=problem.epochs)
            assert evaluation.losses == full(table, row, seed).training.validation_losses
        found.add(row)
    every = [dict(zip(problem.genes, values, strict=True)) for values in product(*problem.genes.values())]
    assert every == [genome for genome, _ in written]
    assert len(every) == len(found) == len(table.networks) - 1 == 768


def test_fitness_is_of_the_first_epochs_by_its_rule(table: SpaceTable) -> None:
    """As a search of so many epochs has it; the cost is what its budget counts."""
    genes, images = genes_of(table, 1), table.header.data.counts[0]
    for rule, of in (("lowest", min), ("last", lambda losses: losses[-1])):
        problem = tacevo.open_table(table.path).as_problem(rule=rule)
        for epochs in range(1, problem.epochs + 1):
            evaluation = problem.evaluate(genes, seed=2, epochs=epochs)
            losses = full(table, 1, 2).training.validation_losses[:epochs]
            assert (evaluation.losses, evaluation.fitness, evaluation.epochs) == (losses, of(losses), epochs)
            profile = table.networks[1].profile
            assert profile is not None
            assert evaluation.flops == training_flops([("", profile.flops)], images=images, epochs=epochs)


def test_judge_has_not_seen_what_chose(table: SpaceTable, problem: SpaceProblem) -> None:
    """It takes the mean logarithm of the test losses of all other seeds, and one at least."""
    genes = genes_of(table, 5)
    logs = [math.log(full(table, 5, seed).metrics["cross_entropy"]) for seed in range(3)]
    assert problem.judge(genes, seen=[1]) == pytest.approx((logs[0] + logs[2]) / 2)
    assert problem.judge(genes, seen=[0, 1, 0]) == pytest.approx(logs[2])
    assert problem.judge(genes, seen=[]) == pytest.approx(sum(logs) / 3)
    with refused(ConfigError, place="seen"):
        problem.judge(genes, seen=[0, 1, 2])


def test_equal_questions_have_equal_answers(table: SpaceTable, problem: SpaceProblem) -> None:
    """In any order of genes, by numbers and texts of numpy, whatever was asked before; and nothing of it can change."""
    genes = genes_of(table, 6)
    first = problem.evaluate(genes, seed=0, epochs=3)
    problem.evaluate(genes_of(table, 1), seed=1, epochs=4)
    others: Mapping[str, Any] = {
        "residual": np.bool_(genes["residual"]),
        "hidden": np.int64(genes["hidden"]),
        "dropout": np.float64(genes["dropout"]),
        "norm": np.str_(genes["norm"]),
    }
    turned = dict(reversed({**genes, **others}.items()))
    assert problem.evaluate(turned, seed=np.int64(0), epochs=np.int64(3)) == first  # type: ignore[arg-type]
    assert problem.judge(turned, seen=np.arange(1)) == problem.judge(genes, seen=[0])
    with pytest.raises(TypeError):
        problem.genes["depth"] = (1,)  # type: ignore[index]


def test_network_that_failed_is_the_worst_and_costs_nothing(table: SpaceTable, tmp_path: Path) -> None:
    """Failed in training, or refused by the gate: an optimiser goes on."""
    refusal = Rejection(stage=Stage.probe, reason=Reason.too_many_flops, detail="")
    networks = list(table.networks)
    networks[2] = replace(networks[2], profile=None, rejection=refusal)
    trainings = [row for row in table.trainings if row.network != 2]
    problem = tacevo.open_table(write_table(tmp_path / "t.zip", table.header, networks, trainings).path).as_problem()
    for row in (2, 3):
        assert problem.evaluate(genes_of(table, row), seed=0, epochs=1) == Evaluation(math.inf, (), 0, 0)
        assert problem.judge(genes_of(table, row), seen=[0]) == math.inf


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"dept": 2}, "genes"),
        ({1: 2}, "genes"),
        ({"depth": 3}, "genes.depth"),
        ({"depth": "2"}, "genes.depth"),
        ({"depth": [2]}, "genes.depth"),
        ({"depth": None}, "genes.depth"),
        ({"dropout": math.nan}, "genes.dropout"),
        ({"norm": np.array(["none"])}, "genes.norm"),
    ],
)
def test_other_genes_are_refused(table: SpaceTable, problem: SpaceProblem, change: Any, place: str) -> None:
    """A gene or a choice that the space does not have names the place; so does one that is missing."""
    genes = genes_of(table, 1)
    for ask in (
        lambda genes: problem.evaluate(genes, seed=0, epochs=1),
        lambda genes: problem.judge(genes, seen=[0]),
    ):
        with refused(ConfigError, place=place):
            ask({**genes, **change})
        with refused(ConfigError, place="genes"):
            ask({name: value for name, value in genes.items() if name != "pooling"})
        for other in (None, list(genes), "depth"):
            with refused(ConfigError, place="genes"):
                ask(other)


@pytest.mark.parametrize("value", [-1, 3, True, 0.0, "0", None])
def test_other_seeds_and_lengths_are_refused(table: SpaceTable, problem: SpaceProblem, value: Any) -> None:
    """A recorded seed and a number of recorded epochs are whole numbers within their range."""
    genes = genes_of(table, 1)
    with refused(ConfigError, place="seed"):
        problem.evaluate(genes, seed=value, epochs=1)
    with refused(ConfigError, place="epochs"):
        problem.evaluate(genes, seed=0, epochs=5 if value == 3 else value)
    for seen in ([value], value):
        with refused(ConfigError, place="seen"):
            problem.judge(genes, seen=seen)
    with refused(ConfigError, place="rule"):
        tacevo.open_table(table.path).as_problem(rule=value)


def test_table_without_its_whole_space_is_no_problem(table: SpaceTable, tmp_path: Path) -> None:
    """Where a network is missing, or stands in the place of another, an optimiser would ask for what is not there."""
    fewer = [row for row in table.trainings if row.network < 8]
    twice = [*table.networks[:8], replace(table.networks[8], genome=table.networks[7].genome)]
    for networks, trainings in ((table.networks[:8], fewer), (twice, table.trainings)):
        written = write_table(tmp_path / "partly.zip", table.header, networks, trainings)
        with refused(BundleError, place=str(written.path)):
            tacevo.open_table(written.path).as_problem()
