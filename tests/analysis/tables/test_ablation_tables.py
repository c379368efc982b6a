"""Promise: the tables of a sweep say what was found, how it was found, what is void and what is missing."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pandas as pd
from hand_runs import altered
from hand_sweeps import NONE, WORSE, compared, curves_of, finished, jobs_of, run_to, sweep_of

from analysis.sweeps.ablation import Ablation, compare_arms, jobs_frame
from analysis.sweeps.arm_metrics import TESTED, Metric
from analysis.sweeps.common_archive import EXTENTS
from analysis.table import HalfInteger, Interval, Percent, PercentInterval, PValue, Table
from analysis.tables.ablation import ablation_tables, arms_table, common_note, extents_note, metric_table, runs_table
from analysis.tables.rendering import as_markdown
from tacevo.choices import ChosenBy, Primary
from tacevo.config.identity import twins_of
from tacevo.results.job_scores import JobScore
from tacevo.results.sweep import FinishedJob, Missing, RecordedSweep
from tacevo.storage.sweep_directory import Job, Retraining, SweepTerms

ARCHIVE = common_note("none-seed0")
SWEEP, FOUND = compared(*jobs_of("none", NONE), *jobs_of("same", NONE), *jobs_of("worse", WORSE))


def best(sweep: RecordedSweep = SWEEP, ablation: Ablation = FOUND) -> Table:
    """Return the table of the best fitness."""
    return metric_table(sweep, ablation, Metric.best_fitness, ARCHIVE)


def test_every_metric_has_a_table() -> None:
    """Named after it, beside that of all arms and that of all runs."""
    names = [table.name for table in ablation_tables(SWEEP, FOUND, ARCHIVE)]
    metrics = [f"ablation_{metric.name}" for metric in Metric if metric not in TESTED]
    assert names == ["ablation", "ablation_settings", *metrics, "ablation_runs"]


def test_bounds_of_the_common_archive_name_whom_they_are_due_to() -> None:
    """One candidate, the first of several, or nobody where a bound is fixed; and how full the fullest tenth is."""
    rows = [
        ("architecture diversity", 0.1, 0.9, ("a/g00s01",), ("b/g01s00", "b/g02s01", "c/g02s01"), 0.4),
        ("efficiency ratio (log)", 0.0, 12.5, (), (), 0.125),
    ]
    note = extents_note(pd.DataFrame(rows, columns=list(EXTENTS)))
    assert "0.100 (a/g00s01) to 0.900 (b/g01s00 and 2 more)" in note
    assert "(fixed) to 12.5 (fixed)" in note
    assert [share for share in ("40.0 %", "12.5 %") if share not in note] == []


def test_free_answers_have_no_table_of_costs() -> None:
    """Where nothing cost anything, there is nothing to compare."""
    free = replace(FOUND, jobs=FOUND.jobs.assign(**{Metric.cost.name: 0.0}))
    assert "ablation_cost" not in [table.name for table in ablation_tables(SWEEP, free, ARCHIVE)]


def test_arms_have_a_median_and_its_interval() -> None:
    """Fractions are percentages; five equal seeds have an interval without width."""
    row = dict(zip(arms_table(SWEEP, FOUND, "n").columns, arms_table(SWEEP, FOUND, "n").rows[0], strict=True))
    assert (row["arm"], row["seeds"]) == ("none", 5)
    assert row["best fitness"] == Interval(0.42, 0.40, 0.44)
    assert row["improvement over the baseline"] == PercentInterval(0.475, 0.45, 0.5)
    assert row["evaluations"] == Interval(2, 2, 2)
    assert row["tokens"] == Interval(15, 15, 15)
    assert row["cost (USD)"] == Interval(0.25, 0.25, 0.25)


def test_tested_arm_has_every_column() -> None:
    """Five seeds above five: U 25, p 2 / 252, A12 1; p is Holm's over two arms."""
    row = dict(zip(best().columns, best().rows[2], strict=True))
    assert (row["arm"], row["U"], row["p"], row["method"]) == (
        "worse",
        HalfInteger(25.0),
        PValue(0.00793650794),
        "exact",
    )
    assert row["p, Holm"] == PValue(0.0158730159)
    assert not [note for note in best().notes if "rimary" in note or "econdary" in note]  # the sweep states none
    assert row["A12"] == Interval(1, 0.642702824, 1)
    assert row["median difference by seed"] == Interval(0.1, 0.1, 0.1)
    assert (row["seeds better"], row["seeds equal"], row["seeds worse"]) == (0, 0, 5)


def test_identical_arm_shows_the_word() -> None:
    """Not p = 1, as if it had been tested; a note says why."""
    row = dict(zip(best().columns, best().rows[1], strict=True))
    assert (row["U"], row["p"], row["p, Holm"], row["A12"]) == (None, "identical", None, None)
    assert [row[f"seeds {word}"] for word in ("better", "equal", "worse")] == [0, 0, 0]
    assert any(
        note.startswith("Identical: same. No run of such an arm differs from that of none") for note in best().notes
    )


def configured(arm: str, seed: int, bests: Sequence[float] = NONE, **settings: Any) -> FinishedJob:
    """Make a job of `none`'s search, or of another, under other settings."""
    (job,) = jobs_of(arm, bests[seed : seed + 1])
    return finished(arm, seed, job.run, settings=settings)


def test_arm_without_a_record_of_prompts_is_named_the_reference() -> None:
    """Its settings alone say so, where prompts are drawn uniformly; where they are not, it is an arm as any other."""
    jobs = [configured("none", seed) for seed in range(5)]
    jobs += [configured("worse", seed, WORSE, archive={"kind": "best"}) for seed in range(5)]
    without = [configured("without", seed, prompts={"policy": "none"}) for seed in range(5)]
    sweep = sweep_of([*jobs, *without])
    assert twins_of("none", sweep.twins) == ["without"]
    ablation = compare_arms(compared(*jobs, *without)[1].jobs, twins=sweep.twins)
    table = best(sweep, ablation)
    told = next(note for note in table.notes if note.startswith("Identical by construction: without."))
    assert "prompts=uniform" in told
    assert any("corrected over 1 arm after Holm" in note for note in table.notes)
    overview = arms_table(sweep, ablation, "n")
    assert told in overview.notes
    assert "Runs of such arms and one seed were compared: they are equal, candidate by candidate." in overview.notes
    marks = {row[0]: row[2] for row in overview.rows}
    assert (overview.columns[2], marks) == ("equal to", {"none": None, "worse": None, "without": "none"})
    curious = [configured(one.job.arm, one.job.seed, prompts={"policy": "curiosity"}) for one in jobs[:5]]
    assert twins_of("none", sweep_of([*curious, *without]).twins) == []
    assert "equal to" not in arms_table(SWEEP, FOUND, "n").columns


def test_twins_that_differ_are_an_error_that_is_told_first() -> None:
    """By their pairs of jobs, also where neither arm is the reference, or a seed is in one of both alone."""
    jobs = [configured("none", seed, archive={"kind": "best"}) for seed in range(5)]
    jobs += [configured("a", seed) for seed in range(5)]
    jobs += [configured("b", seed, (*NONE[:3], 0.9, 0.9), prompts={"policy": "none"}) for seed in range(1, 4)]
    sweep, ablation = compared(*jobs)
    assert sweep.twins == [("a", "b")]
    ablation = compare_arms(ablation.jobs, twins=sweep.twins)
    for table in (arms_table(sweep, ablation, "n"), best(sweep, ablation)):
        (error,) = (note for note in table.notes if note.startswith("ERROR"))
        assert "a-seed3 and b-seed3 are one search by construction, and differ" in error
        assert "seed2" not in error
        assert not any("they are equal" in note for note in table.notes)
        assert any(note.startswith("Identical by construction: a and b,") for note in table.notes)


def test_temperature_of_the_grammar_is_explained_where_arms_differ_in_it() -> None:
    """In the overview, in each metric, and beside the settings; nowhere else."""
    cold = [configured("cold", seed, temperature={"start": 0.0}) for seed in range(5)]
    sweep, ablation = compared(*(configured("none", seed) for seed in range(5)), *cold)
    for table in ablation_tables(sweep, ablation, ARCHIVE):
        told = any("mutation strength" in note for note in table.notes)
        assert told == (table.name != "ablation_runs"), table.name
    others = [note for table in ablation_tables(SWEEP, FOUND, ARCHIVE) for note in table.notes]
    assert not any("mutation strength" in note for note in others)


def test_one_run_that_differs_is_no_sample() -> None:
    """The arm has no p, a note says why, and it still counts in Holm's correction."""
    sweep, ablation = compared(*jobs_of("none", NONE), *jobs_of("once", (0.40, 0.41, 0.42, 0.43, 0.1)))
    table = best(sweep, ablation)
    row = dict(zip(table.columns, table.rows[1], strict=True))
    assert (row["runs that differ"], row["U"], row["p, Holm"]) == (1, None, None)
    assert any(note.startswith("Too few runs differ: once. A test needs two") for note in table.notes)
    assert any("corrected over 1 arm after Holm" in note for note in table.notes)


def test_runs_that_differ_are_counted() -> None:
    """Three of five runs are those of `none`: the row counts two, and the notes say how little two can show."""
    sweep, ablation = compared(*jobs_of("none", NONE), *jobs_of("half", (0.40, 0.31, 0.42, 0.33, 0.44)))
    table = best(sweep, ablation)
    row = dict(zip(table.columns, table.rows[1], strict=True))
    assert (row["seeds"], row["runs that differ"], row["U"]) == (5, 2, HalfInteger(0.0))
    assert [row[f"seeds {word}"] for word in ("better", "equal", "worse")] == [2, 0, 0]
    assert any(note.startswith("Runs that differ: those that are not the run of none") for note in table.notes)
    assert any("with less: 93.8 % for 5 seeds, 50.0 % for 2 seeds." in note for note in table.notes)
    assert "half: no result of so few seeds is significant after Holm's correction." in table.notes


def test_runs_that_differ_are_counted_without_a_value() -> None:
    """Five runs differ, also where only three of them have a price."""
    unpriced = [finished("a", seed, run_to(0.8, 0.3)) for seed in (3, 4)]
    sweep, ablation = compared(*jobs_of("none", NONE), *jobs_of("a", WORSE[:3]), *unpriced)
    table = metric_table(sweep, ablation, Metric.cost, ARCHIVE)
    row = dict(zip(table.columns, table.rows[1], strict=True))
    assert (row["seeds"], row["runs that differ"]) == (3, 5)


STATED = SweepTerms(
    primary=Primary.test_score,
    reference="none",
    retraining=Retraining(seeds=5, epochs=9, choose=ChosenBy.fitness),
)


def scored(bests: Sequence[float], arm: str) -> list[FinishedJob]:
    """Make an arm's jobs, whose networks score a tenth of their fitness on the test images."""
    return [
        replace(
            one,
            tested=JobScore(
                metric="mse", networks=("g01s00",), values=((best / 10,),), losses=((best / 10,),), late=1, trivial={}
            ),
        )
        for one, best in zip(jobs_of(arm, bests), bests, strict=True)
    ]


def test_primary_metric_is_told_and_the_noisy_minimum_is_secondary() -> None:
    """The test score comes first, with how it came about; all else is called secondary, the best fitness noisy."""
    sweep, ablation = compared(*scored(NONE, "none"), *scored(WORSE, "worse"))
    sweep, ablation = replace(sweep, terms=STATED), replace(ablation, primary=Metric.test_mse)
    table = metric_table(sweep, ablation, Metric.test_mse, ARCHIVE)
    row = dict(zip(table.columns, table.rows[1], strict=True))
    assert (row["median"], row["p"]) == (Interval(0.052, 0.05, 0.054), PValue(0.00793650794))
    assert table.notes[0].startswith("Primary metric: test MSE, as the sweep stated when it began")
    assert "trained for 9 epochs with 5 fresh seeds." in table.notes[1]
    assert best(sweep, ablation).notes[0].startswith("Secondary metric; the primary one is test MSE.")
    assert "noisy minimum" in best(sweep, ablation).notes[0]
    assert arms_table(sweep, ablation, "n").columns[2:5] == ("test MSE", "test loss", "best fitness")
    assert "10 of 50 trainings had the best epoch in the last tenth" in " ".join(table.notes)
    several = replace(STATED, retraining=Retraining(elites=2, seeds=5, epochs=9, choose=ChosenBy.reestimated))
    first, *others = sweep.finished
    assert first.tested is not None
    alone = replace(first, tested=replace(first.tested, networks=("g00s00",) * 2, lacking=2))
    few = replace(sweep, terms=several, finished=(alone, *others))
    told = " ".join(metric_table(few, ablation, Metric.test_loss, ARCHIVE).notes)
    assert "the 2 networks with the best median fitness in a noise run" in told
    assert "the baseline counts in the places that are left, so that every value is of as many: none-seed0 (2)." in told
    assert "10 of 50 trainings had the best epoch" in told  # it was trained once
    late = replace(sweep, terms=replace(STATED, primary=None))
    assert "after their searches" in metric_table(late, ablation, Metric.test_mse, ARCHIVE).notes[0]


def test_arm_that_is_not_to_be_tested_is_in_no_family_of_the_test_scores() -> None:
    """It is compared in all else, and its failed jobs are no test's; the other arm alone is corrected for."""
    jobs = [*scored(NONE, "none"), *scored(WORSE, "worse"), *jobs_of("left", WORSE)]
    failed = [replace(jobs[-1].job, name=f"left-seed{seed}", seed=seed) for seed in (5, 6)]
    sweep, _ = compared(*jobs)
    stated = Retraining(seeds=5, epochs=9, choose=ChosenBy.fitness, arms=("none", "worse"))
    sweep = replace(sweep, terms=replace(STATED, retraining=stated))
    assert sweep.not_tested == ["left"]
    frame = jobs_frame(sweep.finished, curves_of(sweep.finished))
    ablation = compare_arms(frame, failed=failed, not_tested=sweep.not_tested)
    tests, fitness = ablation.arms[Metric.test_mse], ablation.arms[Metric.best_fitness]
    assert tests.comparability["left"] == "not tested"
    assert (tests.n["left"], tests.n_arm["left"], fitness.n_arm["left"]) == (0, 0, 7)
    assert tests.p_holm["worse"] == tests.p["worse"]
    assert any("corrected over 2 arms after Holm" in note for note in best(sweep, ablation).notes)
    notes = metric_table(sweep, ablation, Metric.test_mse, ARCHIVE).notes
    assert "Not tested, as the sweep states: left. No family counts such an arm." in notes
    assert any("corrected over 1 arm after Holm" in note for note in notes)


def test_primary_metric_without_values_is_missed() -> None:
    """A sweep that stated a test score, and whose jobs were not tested, does not hide it."""
    sweep = replace(SWEEP, terms=replace(STATED, retraining=None))
    notes = arms_table(sweep, replace(FOUND, primary=Metric.test_mse), "n").notes
    (note,) = (note for note in notes if note.startswith("No job has a test MSE yet"))
    assert "tacevo study sweep=DIR" in note
    tables = ablation_tables(sweep, replace(FOUND, primary=Metric.test_mse), "n")
    assert [table.name for table in tables if "`" in as_markdown(table)] == []  # Markdown's escapes would be typed, too
    untested = replace(sweep, untested=(Missing(job=SWEEP.finished[0].job, reason="r"),))
    assert "Without a test score, 1 job: none-seed0." in best(untested).notes
    _, tested = compared(*scored(NONE, "none"), *scored(WORSE, "worse"))
    table = metric_table(untested, tested, Metric.test_mse, ARCHIVE)
    assert not any(note.startswith("Failed") for note in table.notes)
    failed = replace(sweep, untested=(Missing(job=SWEEP.finished[0].job, reason="r", has_failed=True),))
    table = metric_table(failed, tested, Metric.test_mse, ARCHIVE)
    (note,) = (note for note in table.notes if note.startswith("Failed, 1 job"))
    assert "none-seed0 (arm none, its test)." in note
    assert not any(note.startswith("Failed") for note in best(failed).notes)


def test_detectable_effect_stands_beside_each_test() -> None:
    """By Noether's formula, of the runs that differ: ten against ten detect an A12 of 0.5 + 2.80159 / sqrt(60)."""
    sweep, ablation = compared(
        *jobs_of("none", [*NONE, *WORSE]), *jobs_of("a", [value + 1 for value in (*NONE, *WORSE)])
    )
    (note,) = (note for note in best(sweep, ablation).notes if note.startswith("Detected by"))
    assert note.startswith("Detected by 10 runs of an arm and 10 of none with a power of 80 %")
    assert "an A12 of 0.862 or 0.138" in note
    (few,) = (note for note in best().notes if note.startswith("Detected by"))
    assert "effects near full separation only" in few


def test_reference_that_was_named_afterwards_is_told() -> None:
    """Whoever looks for an arm to beat can find one; a reader has to know."""
    jobs = [*jobs_of("none", NONE), *jobs_of("worse", WORSE)]
    ablation = compare_arms(compared(*jobs)[1].jobs, requested_reference="worse")
    told = "The reference worse was named for this comparison; the sweep itself states"
    assert any(note.startswith(told) for note in best(sweep_of(jobs), ablation).notes)
    stated = replace(sweep_of(jobs), terms=SweepTerms(reference="worse"))
    assert not any(note.startswith(told) for note in best(stated, ablation).notes)


def test_single_seed_is_a_value_alone() -> None:
    """Without interval, and with the reason below; the test is void by that word."""
    sweep, ablation = compared(*jobs_of("none", NONE), *jobs_of("one", WORSE[:1]))
    row = best(sweep, ablation).rows[1]
    assert row[:6] == ("one", 1, 0.5, 1, None, "too few seeds")
    assert row[10:] == (None, None, 0, 0, 1)
    assert any("A single value has neither interval nor test" in note for note in best(sweep, ablation).notes)


def test_notes_count_the_known_values_of_the_metric() -> None:
    """Five seeds of which two have a price are two to the cost, and five to the fitness."""
    unpriced = [finished("none", seed, run_to(0.5, 0.4)) for seed in range(2, 5)]
    sweep, ablation = compared(*jobs_of("none", NONE[:2]), *unpriced)
    cost = metric_table(sweep, ablation, Metric.cost, ARCHIVE)
    assert cost.rows[0][1] == 2
    assert any("with less: 50.0 % for 2 seeds." in note for note in cost.notes)
    assert any("with less: 93.8 % for 5 seeds." in note for note in best(sweep, ablation).notes)
    assert not any("their range" in note for note in best(*compared(*jobs_of("none", [*NONE, 0.3]))).notes)
    assert any("93.8 % for 5 seeds, 50.0 % for 2 seeds." in note for note in arms_table(sweep, ablation, "").notes)


def test_jobs_at_chance_are_counted_and_named() -> None:
    """Below the arms; where the trivial loss is not known, or all learned, there is no such note."""
    assert not any("At chance" in note for note in arms_table(SWEEP, FOUND, "n").notes)
    jobs = list(SWEEP.finished)
    for at in (1, 4):
        best_loss = jobs[at].run.generations[-1].best
        jobs[at] = replace(jobs[at], run=altered(jobs[at].run, trivial=best_loss))
    jobs[2] = replace(jobs[2], run=altered(jobs[2].run, trivial=100.0))
    (note,) = [one for one in arms_table(replace(SWEEP, finished=tuple(jobs)), FOUND, "n").notes if "At chance" in one]
    assert [one.job.name for one in jobs if one.job.name in note] == [jobs[1].job.name, jobs[4].job.name]
    assert f"2 of {len(jobs)}" in note


def test_missing_reference_is_told() -> None:
    """All columns of tests are empty."""
    sweep, ablation = compared(*jobs_of("a", NONE), *jobs_of("b", WORSE))
    assert all(set(row[3:]) == {None} for row in best(sweep, ablation).rows)
    for table in (arms_table(sweep, ablation, "n"), best(sweep, ablation)):
        assert any("no finished run of the arm none" in note for note in table.notes)


def test_missing_jobs_are_told() -> None:
    """Below every table: their runs are in no figure of it."""
    job = Job(name="worse-seed5", arm="worse", seed=5, overrides=(), config="")
    sweep = replace(SWEEP, missing=(Missing(job=job, reason="not begun"),))
    tables = [table for table in ablation_tables(sweep, FOUND, ARCHIVE) if table.name != "ablation_settings"]
    for table in tables:
        assert any(note.startswith("Missing, 1 job: worse-seed5.") for note in table.notes)


def test_runs_are_listed_one_by_one() -> None:
    """Whoever doubts a median can count again."""
    table = runs_table(SWEEP, FOUND, "none-seed0")
    assert [row[0] for row in table.rows] == [job.job.name for job in SWEEP.finished]
    row = dict(zip(table.columns, table.rows[1], strict=True))
    assert (row["arm"], row["seed"], row["best fitness"]) == ("none", 1, 0.41)
    assert row["improvement over generation 0"] == Percent(0.4875)
