"""Promise: runs of other data, budgets, versions or niches, and arms of two searches, are refused by name and value."""

from dataclasses import replace

import pytest
from hand_runs import altered
from hand_sweeps import VERSIONS, finished, run_to, sweep_of
from refusals import refused

from tacevo.choices import Varied
from tacevo.errors import IncomparableError
from tacevo.results.sweep import FinishedJob
from tacevo.results.sweep_checks import VERSIONS as CHECKED
from tacevo.results.sweep_checks import check_sweep
from tacevo.rules import FIRST
from tacevo.storage.sweep_directory import SweepTerms

RUN = run_to(0.5, 0.4)

#: Other rules than those of `RUN`.
CHANGED = replace(FIRST, static=9)


def beside(other: FinishedJob) -> None:
    """Check a sweep of a job and another."""
    check_sweep(sweep_of([finished("none", 0, RUN), other]))


def test_data_of_two_seeds_may_differ_where_the_sweep_takes_them_from_the_seed() -> None:
    """And only then; data of one seed are the same in all arms, or a difference between arms would be one of data."""
    other = altered(RUN, facts=replace(RUN.facts, fingerprint="other"))
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


FIRST_CANDIDATE, *OTHERS = RUN.candidates

#: A job beside that of `RUN`, the place of what differs, both values, and a word of the remedy.
DIFFERENT: list[tuple[FinishedJob, str, tuple[str, str], str]] = [
    *(
        (finished("a", 0, RUN, settings=settings), place, values, remedy)
        for settings, place, values, remedy in (
            ({"search": {"candidates": 3}}, "search.candidates", ("2", "3"), "budget"),
            ({"search": {"initial": 9}}, "search.initial", ("1", "9"), "budget"),
            ({"training": {"epochs": 9}}, "training.epochs", ("1", "9"), "budget"),
            ({"task": {"name": "grating"}}, "task.name", ('"force"', '"grating"'), "data"),
            ({"numerics": {"kind": "fast"}}, "numerics.kind", ('"portable"', '"fast"'), "store.root"),
            ({"archive": {"niches": 9}}, "archive.niches", ("4", "9"), "niches"),
            ({"archive": {"seed": 1}}, "archive.seed", ("0", "1"), "niches"),
            (
                {
                    "training": {"device": "cuda", "gpu": "X"},
                    "sandbox": {"require": "none"},
                    "numerics": {"kind": "fast"},
                },
                *("training.device", ('"cpu"', '"cuda"'), "budget"),
            ),
        )
    ),
    *(
        (finished("a", 0, run), place, values, remedy)
        for run, place, values, remedy in (
            (altered(RUN, facts=replace(RUN.facts, fingerprint="cd")), "fingerprint of the data", ("ab", "cd"), "data"),
            # An improvement over another network would be another number.
            (
                altered(RUN, candidates=(replace(FIRST_CANDIDATE, source="another"), *OTHERS)),
                *("hash of the baseline's source", ("g00s00", "another"), "baseline"),
            ),
            # As the ledger has them: a continued run has more than it was begun with.
            (run_to(0.5, 0.4, 0.3), "number of generations", ("1", "2"), "budget"),
            # One package version may have had several rules.
            (altered(RUN, rules=CHANGED), *("rules", ("static 1,", "static 9,"), "store.root")),
            *(
                (
                    altered(RUN, versions={**VERSIONS, package: "2.0"}),
                    *(f"version of {package}", ("1.0", "2.0"), "store.root"),
                )
                for package in CHECKED
            ),
        )
    ),
    # A median over seeds of two searches would be that of neither.
    (
        finished("none", 1, RUN, settings={"temperature": {"rule": "fixed"}}),
        *("temperature.rule", ("paper", "fixed"), "to the arm"),
    ),
]


@pytest.mark.parametrize(("other", "place", "values", "remedy"), DIFFERENT)
def test_jobs_that_differ_are_refused(other: FinishedJob, place: str, values: tuple[str, str], remedy: str) -> None:
    """The message has both jobs, the field, both values, and what to do."""
    with refused(IncomparableError, place=place, got="in none-seed0 and", remedy=remedy) as caught:
        beside(other)
    one, two = caught.value.got.split(" in none-seed0 and ")
    assert values[0] in one
    assert values[1] in two
    assert two.endswith(other.job.name)


def test_other_version_of_what_decides_nothing_is_let_through() -> None:
    """A mirror's, for one; of two versions that differ, the one that decides is named."""
    mirrored = {**VERSIONS, "mlflow": "9.9"}
    beside(finished("a", 0, altered(RUN, versions=mirrored)))
    with refused(IncomparableError, place="version of torch"):
        beside(finished("a", 0, altered(RUN, versions={**mirrored, "torch": "0.1"})))


def test_runs_that_one_budget_ended_may_differ_in_their_generations() -> None:
    """What must be equal then is the budget, and the generations that there might have been."""
    bound = {"search": {"training_flops": 1e9}}
    longer = run_to(0.5, 0.4, 0.3)
    jobs = [finished("none", 0, RUN, settings=bound), finished("a", 0, longer, settings=bound)]
    check_sweep(sweep_of(jobs))
    other = finished("a", 0, longer, settings={"search": {"training_flops": 2e9}})
    with refused(IncomparableError, place="search.training_flops", got="2000000000.0 in a-seed0"):
        check_sweep(sweep_of([jobs[0], other]))
