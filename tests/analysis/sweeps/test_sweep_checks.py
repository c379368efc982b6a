"""Promise: runs of other data, budgets, versions or niches, and arms of two searches, are refused by name and value."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest
from hand_sweeps import VERSIONS, finished, run_to, sweep_of
from refusals import refused

from tacevo.choices import Varied
from tacevo.errors import IncomparableError
from tacevo.results.sweep import Finished
from tacevo.results.sweep_checks import VERSIONS as CHECKED
from tacevo.results.sweep_checks import check_sweep
from tacevo.rules import FIRST
from tacevo.storage.sweep_directory import SweepTerms

RUN = run_to(0.5, 0.4)

#: Other rules than those of `RUN`.
CHANGED = replace(FIRST, static=9)


def beside(other: Finished) -> None:
    """Check a sweep of a job and another."""
    check_sweep(sweep_of([finished("none", 0, RUN), other]))


def test_data_of_two_seeds_may_differ_where_the_sweep_takes_them_from_the_seed() -> None:
    """And only then; data of one seed are the same in all arms, or a difference between arms would be one of data."""
    other = replace(RUN, facts=replace(RUN.facts, fingerprint="other"))
    jobs = [finished(arm, seed, run) for arm in ("none", "a") for seed, run in enumerate((RUN, other))]
    varied = SweepTerms(vary=(Varied.splitting,))
    check_sweep(replace(sweep_of(jobs), terms=varied))
    with refused(IncomparableError, place="fingerprint of the data"):
        check_sweep(sweep_of(jobs))
    torn = [*jobs[:3], finished("a", 1, RUN)]
    with refused(IncomparableError, place="fingerprint of the data", got="none-seed1"):
        check_sweep(replace(sweep_of(torn), terms=varied))


def test_arms_may_differ_in_how_they_search() -> None:
    """Temperature, prompts, proposals, model and kind of archive are what a sweep is about; places of runs are not."""
    searches = {"temperature": {"rule": "fixed"}, "prompts": {"policy": "none"}, "llm": {"model": "other"}}
    check_sweep(
        sweep_of(
            [
                finished("none", 0, RUN),
                finished("none", 1, RUN, settings={"store": {"root": "moved"}, "executor": {"workers": 9}}),
                finished("other", 0, RUN, settings=searches),
                finished("log", 0, RUN, settings={"archive": {"eff_ratio_scale": "log", "niches": 9}}),
            ]
        )
    )


@pytest.mark.parametrize(
    ("settings", "place", "values", "remedy"),
    [
        ({"search": {"candidates": 3}}, "search.candidates", ("2", "3"), "budget"),
        ({"search": {"initial": 9}}, "search.initial", ("1", "9"), "budget"),
        ({"training": {"epochs": 9}}, "training.epochs", ("1", "9"), "budget"),
        (
            {"training": {"device": "cuda", "gpu": "X"}, "sandbox": {"require": "none"}, "numerics": {"kind": "fast"}},
            *("training.device", ('"cpu"', '"cuda"'), "budget"),
        ),
        ({"task": {"name": "grating"}}, "task.name", ('"force"', '"grating"'), "data"),
        ({"numerics": {"kind": "fast"}}, "numerics.kind", ('"portable"', '"fast"'), "store.root"),
        ({"archive": {"niches": 9}}, "archive.niches", ("4", "9"), "niches"),
        ({"archive": {"seed": 1}}, "archive.seed", ("0", "1"), "niches"),
    ],
)
def test_other_settings_are_refused(
    settings: Mapping[str, Any], place: str, values: tuple[str, str], remedy: str
) -> None:
    """The message has both jobs, the field, both values, and what to do."""
    with refused(
        IncomparableError, place=place, got="{} in none-seed0 and {} in a-seed0".format(*values), remedy=remedy
    ):
        beside(finished("a", 0, RUN, settings=settings))


def test_other_data_are_refused() -> None:
    """By their fingerprint, wherever they lie."""
    other = replace(RUN, facts=replace(RUN.facts, fingerprint="cd"))
    with refused(IncomparableError, place="fingerprint of the data", got='"ab" in none-seed0 and "cd" in a-seed0'):
        beside(finished("a", 0, other))


def test_another_baseline_is_refused() -> None:
    """An improvement over another network would be another number."""
    first, *rest = RUN.candidates
    other = replace(RUN, candidates=(replace(first, source="another"), *rest))
    with refused(IncomparableError, place="hash of the baseline's source", got='"g00s00" in none-seed0 and "another"'):
        beside(finished("a", 0, other))


def test_another_number_of_generations_is_refused() -> None:
    """As the ledger has them: a continued run has more than it was begun with."""
    with refused(IncomparableError, place="number of generations", got="1 in none-seed0 and 2 in a-seed0"):
        beside(finished("a", 0, run_to(0.5, 0.4, 0.3)))


def test_runs_that_one_budget_ended_may_differ_in_their_generations() -> None:
    """What must be equal then is the budget, and the generations that there might have been."""
    bound = {"search": {"training_flops": 1e9}}
    longer = run_to(0.5, 0.4, 0.3)
    jobs = [finished("none", 0, RUN, settings=bound), finished("a", 0, longer, settings=bound)]
    check_sweep(sweep_of(jobs))
    other = finished("a", 0, longer, settings={"search": {"training_flops": 2e9}})
    with refused(IncomparableError, place="search.training_flops", got="2000000000.0 in a-seed0"):
        check_sweep(sweep_of([jobs[0], other]))


@pytest.mark.parametrize("package", CHECKED)
def test_other_versions_are_refused(package: str) -> None:
    """Of all that can change a result; a mirror of another version decides nothing."""
    beside(finished("a", 0, replace(RUN, versions={**VERSIONS, "mlflow": "9.9"})))
    other = finished("a", 0, replace(RUN, versions={**VERSIONS, package: "2.0"}))
    values = '"1.0" in none-seed0 and "2.0" in a-seed0'
    with refused(IncomparableError, place=f"version of {package}", got=values, remedy="store.root"):
        beside(other)


def test_other_rules_are_refused() -> None:
    """As the ledgers have them: one package version may have had several."""
    words = '"static 9, probe 4, training 1, core 1" in a-seed0'
    with refused(IncomparableError, place="rules", got=words):
        beside(finished("a", 0, replace(RUN, rules=CHANGED)))


def test_arm_of_two_configurations_is_refused() -> None:
    """Median over seeds of two searches would be that of neither."""
    got = '"paper" in none-seed0 and "fixed" in none-seed1'
    with refused(IncomparableError, place="temperature.rule", got=got, remedy="to the arm"):
        beside(finished("none", 1, RUN, settings={"temperature": {"rule": "fixed"}}))
