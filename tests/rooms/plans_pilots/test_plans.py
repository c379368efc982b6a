"""Promise: a plan is the cheapest cautious way to find an effect, and its costs can be counted by hand."""

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hand_runs import altered, run, trained
from hand_sweeps import finished, run_of, run_to, sweep_of
from refusals import refused
from studies import FOUR, study_of

from analysis.statistics.planning import Spread, median_deviation, pooled
from analysis.sweeps.pilots import Pilot, study_pilot, sweep_pilot
from analysis.sweeps.plans import RETRAININGS, Wish, plan
from analysis.table import Percent
from analysis.tables.followed_plan import plan_notes
from analysis.tables.plan import plan_table
from tacevo.choices import ChosenBy, Primary
from tacevo.costs import Spending
from tacevo.errors import RunError
from tacevo.records import Kind, Stage
from tacevo.results.job_scores import JobScore
from tacevo.results.sweep import RecordedSweep
from tacevo.storage.plan_file import Measure
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import Retraining, SweepTerms

WISH = Wish(effect=0.1, alpha=0.05, power=0.8, comparisons=2)

STUDY = Pilot(
    kind="study",
    task="force",
    metric=Measure.mse,
    spread=Spread(deviation=0.1, freedom=19),
    within=0.0,
    tested=0.0,
    comparisons=4,
    epochs=50,
    search_epochs=0,
    seconds=3.6,
    runs=("a",),
)
SWEEP = replace(STUDY, kind="sweep", within=0.2, tested=0.05, search_epochs=1000)
PLANNED = functools.cache(functools.partial(plan, SWEEP, WISH))


def test_costs_of_a_study_by_hand() -> None:
    """Each network with each seed, for all epochs; an epoch takes a thousandth of an hour."""
    planned = plan(STUDY, WISH)
    (way,) = planned.ways.itertuples()
    assert (way.trainings, way.searches, way.epochs) == (3 * way.seeds, 0, 150 * way.seeds)
    assert way.hours == pytest.approx(way.epochs / 1000)
    assert planned.chosen == way.Index


def test_plan_is_cautious() -> None:
    """It takes the upper limit of the pilot's spread, so that a smaller pilot needs more seeds."""
    small, large = (plan(replace(STUDY, spread=Spread(deviation=0.1, freedom=n)), WISH) for n in (4, 1000))
    assert small.ways.spread[0] == Spread(deviation=0.1, freedom=4).upper > 0.1
    assert small.ways.seeds[0] > large.ways.seeds[0]


def test_costs_of_a_sweep_by_hand() -> None:
    """Three arms: so many searches, and a training of each job's network and of the baseline with each seed."""
    planned = PLANNED()
    assert planned.ways.retraining.tolist() == list(RETRAININGS)
    for way in planned.ways.itertuples():
        assert (way.searches, way.trainings) == (3 * way.seeds, 4 * way.seeds * way.retraining)
        assert way.epochs == 1000 * way.searches + 50 * way.trainings
        between = math.sqrt(SWEEP.spread.upper**2 - 0.05**2)
        assert way.spread == pytest.approx(math.hypot(between, 0.2 * median_deviation(int(way.retraining))), rel=1e-8)
        assert way.between == pytest.approx(between, rel=1e-8)
    assert planned.ways.epochs[planned.chosen] == planned.ways.epochs.min()


@pytest.mark.parametrize(("between", "jobs", "seeds"), [(4.4, 3, 3), (0.0, 3, 3), (2.0, 5, 5), (4.4, 8, 20)])
def test_searches_are_never_taken_for_equal(between: float, jobs: int, seeds: int) -> None:
    """By simulated pilots of two arms: the limit holds four times of five, and it is never nothing."""
    rng = np.random.default_rng(1)
    searches = rng.normal(0, between, (1000, 2, jobs, 1))
    scores = searches + rng.normal(0, 9.2, (1000, 2, jobs, seeds))
    medians, within = np.median(scores, axis=3), np.sqrt(scores.var(axis=3, ddof=1).mean(axis=(1, 2)))
    limits = np.array(
        [
            replace(SWEEP, spread=spread, within=noise, tested=noise * median_deviation(seeds)).between
            for spread, noise in zip(map(pooled, medians), within.tolist(), strict=True)
            if spread is not None
        ]
    )
    assert (limits > 0).all()
    assert (limits >= between).mean() > 0.77
    assert (replace(SWEEP, tested=0.1).is_all_noise, SWEEP.is_all_noise) == (True, False)


def test_pilot_that_is_all_noise_is_told() -> None:
    """In a note, with the interval that shows how little it knows; a study has no searches."""
    noisy = replace(SWEEP, spread=Spread(deviation=0.1, freedom=4), tested=0.16)
    notes = {pilot.kind: plan_table(plan(pilot, WISH)).notes for pilot in (noisy, STUDY)}
    (told,) = (note for note in notes["sweep"] if note.startswith("Interval searches"))
    assert "all searches might be equal" in told
    low, high = noisy.spread.interval
    assert (low, high) == pytest.approx((0.1 * math.sqrt(4 / 11.1433), 0.1 * math.sqrt(4 / 0.484419)), rel=1e-5)
    assert f"{low:.3g} to {high:.3g}" in told
    assert not any(note.startswith("Interval searches") for note in notes["study"])
    assert "all searches might be equal" not in "".join(plan_table(PLANNED()).notes)


def test_plan_holds_what_was_chosen() -> None:
    """All that the choice followed from, and what came out."""
    planned = PLANNED()
    written, chosen = planned.plan, planned.ways.loc[planned.chosen]
    assert written is not None
    assert (written.effect, written.power, written.comparisons, written.pilots) == (0.1, 0.8, 2, ("a",))
    assert (written.seeds, written.retraining, written.spread) == (chosen.seeds, chosen.retraining, chosen.spread)


def test_unreachable_effect_has_no_plan_and_no_costs() -> None:
    """The table says that all seeds that were tried do not suffice."""
    planned = plan(STUDY, replace(WISH, effect=0.001))
    assert (planned.chosen, planned.plan) == (None, None)
    row = dict(zip(plan_table(planned).columns, plan_table(planned).rows[0], strict=True))
    assert (row["seeds"], row["full trainings"], row["hours"], row["plan"]) == ("more than 200", None, None, None)


def test_accuracy_has_an_effect_in_its_own_unit() -> None:
    """Two points at a spread of two points are one deviation; of an error, 10 % less are -ln 0.9."""
    accuracy = replace(STUDY, metric=Measure.accuracy, spread=Spread(deviation=0.02, freedom=1000))
    error = replace(STUDY, spread=Spread(deviation=-math.log(0.98), freedom=1000))
    wish = replace(WISH, effect=0.02)
    needed = [plan(pilot, wish).ways[["seeds", "chance"]].to_dict() for pilot in (accuracy, error)]
    assert needed[0] == needed[1]
    assert "2.00 percentage points of test accuracy" in plan_table(plan(accuracy, wish)).caption


def test_table_marks_the_plan() -> None:
    """One row of all."""
    table = plan_table(PLANNED())
    assert [row[-1] for row in table.rows].count("chosen") == 1
    assert table.rows[0][4] == Percent(PLANNED().ways.chance[0])


def test_pilot_of_a_study_pools_its_networks() -> None:
    """Logarithms of errors; the networks' medians are far apart, and that is not a spread."""
    pilot = study_pilot([(run([trained(0, 0)], []), study_of(FOUR))])
    by_hand = math.sqrt(np.mean([np.var(np.log(sample), ddof=1) for sample in FOUR.values()]))
    assert (pilot.metric, pilot.comparisons, pilot.spread.freedom) == ("mse", 4, 95)
    assert pilot.spread.deviation == pytest.approx(by_hand, rel=1e-8)
    shares = study_of({"baseline": [0.5, 0.7], "variant 1": [0.9, 0.9]}, kind=Kind.classification)
    assert study_pilot([(run([trained(0, 0)], []), shares)]).spread.deviation == pytest.approx(0.1)


def test_training_that_two_studies_share_counts_once() -> None:
    """With other terms, or more seeds of the same run, a study recalls trainings; it says nothing new by them."""
    whole = study_of(FOUR)
    first = replace(whole, seeds=5, scores=tuple(score for score in whole.scores if score.seed < 5))
    slots = run([trained(0, 0)], [])
    alone = study_pilot([(slots, whole)])
    assert study_pilot([(slots, first), (slots, whole), (slots, whole)]).spread == alone.spread
    another = replace(whole, run="1" * 64)
    assert study_pilot([(slots, whole), (slots, another)]).spread.freedom == 2 * alone.spread.freedom


@pytest.mark.parametrize(
    ("values", "place"),
    [({"baseline": [0.1], "variant 1": [0.2]}, "the pilots"), ({"baseline": [0.1, 0.0]}, "a pilot's mse")],
)
def test_study_without_a_spread_is_not_a_pilot(values: Mapping[str, Sequence[float]], place: str) -> None:
    """One seed does not spread, and 0 has no logarithm."""
    with refused(RunError, place=place):
        study_pilot([(run([trained(0, 0)], []), study_of(values))])


def test_pilots_of_two_tasks_are_refused() -> None:
    """Their values are of different kinds."""
    one, other = study_of(FOUR), replace(study_of(FOUR), task="grating")
    with refused(RunError, place="the pilots", expected="one task"):
        study_pilot([(run([trained(0, 0)], []), study) for study in (one, other)])


def test_pilots_of_unlike_trainings_are_named_in_words() -> None:
    """Studies by task and epochs, sweeps by how their jobs were tested."""
    short, study = (study_of(FOUR), study_of(FOUR))
    long = replace(study, recipe=replace(study.recipe, epochs=study.recipe.epochs + 1))
    with refused(RunError, place="the pilots", got=f"; force, {long.recipe.epochs} epochs, numerics"):
        study_pilot([(run([trained(0, 0)], []), one) for one in (short, long)])


def score_of(*values: tuple[float, ...]) -> JobScore:
    """Make the scores of networks by training seed."""
    return JobScore(metric="mse", networks=("g00s00",) * len(values), values=values, losses=values, late=0)


def sweep_with(arms: Mapping[str, Sequence[tuple[float, ...]]]) -> RecordedSweep:
    """Make a sweep whose jobs have these test scores by training seed."""
    jobs = [
        replace(finished(arm, seed, run_to(0.5)), tested=score_of(values))
        for arm, jobs in arms.items()
        for seed, values in enumerate(jobs)
    ]
    retraining = Retraining(
        seeds=len(jobs[0].tested.values[0]) if jobs[0].tested else 0, epochs=7, choose=ChosenBy.fitness
    )
    return replace(sweep_of(jobs), terms=SweepTerms(retraining=retraining))


def test_pilot_of_a_sweep_has_both_spreads() -> None:
    """By hand, of logarithms: jobs 1 and e are two apart in squares' halves; seeds of a job are 0 and 2 apart."""
    e = math.e
    pilot = sweep_pilot([sweep_with({"none": [(1.0, 1.0, 1.0), (e, e, e)], "a": [(9.0, 9.0, 9.0)]})])
    assert (pilot.metric, pilot.epochs, pilot.comparisons) == ("mse", 7, 1)
    assert pilot.spread.freedom == 1
    assert pilot.spread.deviation == pytest.approx(math.sqrt(0.5), rel=1e-8)
    assert pilot.within == pilot.tested == 0
    noisy = sweep_pilot([sweep_with({"none": [(1.0, e**2), (1.0, e**2)]})])
    assert noisy.within == pytest.approx(math.sqrt(2), rel=1e-8)
    assert noisy.spread.deviation == 0


def test_pilot_that_tests_some_arms_is_planned_by_their_scores() -> None:
    """As if the other arms, which the sweep states to leave untested, were not there."""
    whole = sweep_with({"none": [(1.0, 2.0), (3.0, 3.0)], "a": [(9.0, 2.0), (7.0, 7.0)]})
    left = [finished("left", seed, run_to(best)) for seed, best in enumerate((0.5, 0.9))]
    assert whole.terms.retraining is not None
    terms = SweepTerms(retraining=replace(whole.terms.retraining, arms=("none", "a")))
    some = replace(whole, finished=(*whole.finished, *left), terms=terms)
    assert replace(sweep_pilot([some]), runs=()) == replace(sweep_pilot([whole]), runs=())
    assert sweep_pilot([replace(some, terms=whole.terms)]).metric == "fitness"


def test_pilot_of_several_networks_a_job_is_planned_by_their_losses() -> None:
    """By hand: jobs at 1 and e, seeds of a network 0 and 2 apart; two networks and four seeds leave sqrt(2 / 8)."""
    e = math.e
    jobs = [
        replace(finished("none", seed, run_to(0.5)), tested=score_of((level, level * e**2), (level * e**2, level)))
        for seed, level in enumerate((1.0, e))
    ]
    retraining = Retraining(elites=2, seeds=2, epochs=7, choose=ChosenBy.fitness)
    pilot = sweep_pilot([replace(sweep_of(jobs), terms=SweepTerms(retraining=retraining))])
    assert (pilot.metric, pilot.elites) == ("loss", 2)
    assert pilot.spread.deviation == pytest.approx(math.sqrt(0.5), rel=1e-8)
    assert pilot.within == pytest.approx(math.sqrt(2), rel=1e-8)
    assert pilot.noise(4) == pytest.approx(math.sqrt(2 / 8), rel=1e-8)
    planned = plan(pilot, replace(WISH, effect=0.9))
    for way in planned.ways.itertuples():
        assert way.trainings == (2 * way.searches + way.seeds) * way.retraining
    assert planned.plan is not None
    assert (planned.plan.elites, planned.plan.metric) == (2, "loss")
    told = " ".join((plan_table(planned).caption, *plan_table(planned).notes))
    assert "90.0 % less test loss" in told
    assert "2 networks of each job" in told
    one = replace(sweep_of(jobs), terms=SweepTerms(primary=Primary.test_loss, retraining=replace(retraining, elites=1)))
    assert sweep_pilot([one]).metric == "loss"


def test_run_and_training_that_arms_share_count_once() -> None:
    """An arm that went the reference's way, and the same sweep again, add no degree of freedom, in neither spread."""
    jobs = [finished("none", 0, run_to(0.5)), finished("none", 1, run_to(0.6))]
    same = [finished("same", 0, run_to(0.5)), finished("same", 1, run_to(0.6))]
    other = [finished("other", 0, run_to(0.7)), finished("other", 1, run_to(0.4))]
    assert sweep_pilot([sweep_of([*jobs, *same]), sweep_of(jobs)]).spread == sweep_pilot([sweep_of(jobs)]).spread
    assert sweep_pilot([sweep_of([*jobs, *other])]).spread.freedom == 2
    tests = {"none": [(1.0, 2.0), (1.0, 3.0)], "a": [(1.0, 2.0), (1.0, 9.0)]}
    by_hand = math.sqrt(sum(math.log(factor) ** 2 / 2 for factor in (2, 3, 9)) / 3)
    assert sweep_pilot([sweep_with(tests)]).within == pytest.approx(by_hand, rel=1e-8)


def test_costs_of_a_search_count_all_its_trainings(tmp_path: Path) -> None:
    """By hand: two candidates and one that failed, each of one epoch."""
    lines = [trained(0, 0), trained(1, 0), replace(trained(1, 1), fitness=None, stage=Stage.train)]
    jobs = [finished("none", seed, run_of(lines)) for seed in (0, 1)]
    here = [replace(one, run=altered(one.run, path=tmp_path / one.job.name)) for one in jobs]
    for one in here:
        one.run.path.mkdir()
        RunDirectory(one.run.path).add_timing(Spending(), id="g00s00", seconds=6.0)
    pilot = sweep_pilot([sweep_of(here)])
    assert (pilot.search_epochs, pilot.seconds) == (3, 6.0)


def test_sweep_without_every_test_is_planned_by_its_best_fitness() -> None:
    """One job without a score would be a hole in the arm; the table says so."""
    jobs = [finished("none", seed, run_to(best)) for seed, best in enumerate((0.5, 0.6))]
    pilot = sweep_pilot([sweep_of(jobs)])
    assert (pilot.metric, pilot.epochs, pilot.within) == ("fitness", None, 0)
    assert pilot.spread.deviation == pytest.approx(math.log(0.6 / 0.5) / math.sqrt(2), rel=1e-8)
    planned = plan(pilot, replace(WISH, effect=0.5))
    assert planned.ways.retraining.isna().tolist() == [True]
    assert any("not every job of the pilot has a test score" in note for note in plan_table(planned).notes)
    with refused(RunError, expected="two jobs of an arm"):
        sweep_pilot([sweep_of(jobs[:1])])


def test_plan_that_was_followed_is_told() -> None:
    """Its seeds, what they were to find, and when; without one, nothing."""
    written = plan(STUDY, WISH).plan
    assert written is not None
    (note,) = plan_notes(replace(written, made="2026-11-22"))
    for part in (f"{written.seeds} seeds of each network", "10.0 % less test MSE", "2026-11-22"):
        assert part in note
    assert plan_notes(None) == ()
