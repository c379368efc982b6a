"""Promise: arms are compared by the project's statistics and seed by seed, and never where that is void."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hand_runs import closed, rejected, run, trained
from hand_sweeps import curves_of, finished, run_to
from scipy.stats import mannwhitneyu

from analysis.statistics.tests import holm, mann_whitney
from analysis.studies.warnings import Caution
from analysis.sweeps.ablation import (
    ARMS,
    JOBS,
    Ablation,
    Comparability,
    as_jobs,
    by_generation,
    compare_arms,
    jobs_frame,
    slots_of,
)
from analysis.sweeps.arm_metrics import TESTED, Metric
from tacevo.costs import Spending
from tacevo.results.run import RecordedRun
from tacevo.storage.sweep_directory import Job

NONE = [0.50, 0.52, 0.54, 0.56, 0.58]
BETTER = [0.40, 0.42, 0.44, 0.46, 0.48]
MIXED = [0.49, 0.53, 0.51, 0.57, 0.55]


def jobs(
    arms: Mapping[str, Sequence[float] | Mapping[int, float]], alike: Mapping[str, Collection[int]] | None = None
) -> pd.DataFrame:
    """Make runs of a best fitness each, by the arm's seeds; all other metrics are unknown.

    Runs of equal values are different networks, but for the seeds of an arm that are in `alike`: these are one network.
    """
    alike = alike or {}
    return as_jobs(
        {
            "job": f"{arm}-seed{seed}",
            "arm": arm,
            "seed": seed,
            "best_fitness": value,
            "search": (value, "one" if seed in alike.get(arm, ()) else arm),
        }
        for arm, values in arms.items()
        for seed, value in (values.items() if isinstance(values, Mapping) else enumerate(values))
    )


def contrast(ablation: Ablation, arm: str, metric: Metric = Metric.best_fitness) -> Any:
    """Return an arm's row."""
    return ablation.arms[metric].loc[arm]


def is_untested(row: Any) -> bool:
    """Return whether a row has neither a test nor effects."""
    return bool(row[["u", "p", "p_holm", "method", "a12", "difference", "cautions"]].isna().all())


def values_of(one: RecordedRun) -> dict[str, Any]:
    """Measure a run in an archive of its own."""
    job = [finished("none", 0, one)]
    return dict(jobs_frame(job, curves_of(job)).iloc[0].drop(["arm", "seed", "search"]))


def test_tests_are_those_of_the_project() -> None:
    """Mann-Whitney against `none`, with Holm over the arms; by hand, five seeds apart give 2 / 252."""
    ablation = compare_arms(jobs({"none": NONE, "better": BETTER, "mixed": MIXED}))
    p_values = [mann_whitney(sample, NONE).p for sample in (BETTER, MIXED)]
    assert p_values[0] == pytest.approx(2 / 252)
    told = [contrast(ablation, name) for name in ("better", "mixed")]
    assert [one.p for one in told] == p_values
    assert [one.p_holm for one in told] == list(holm(p_values))


def test_effects_have_the_arm_first() -> None:
    """An arm below `none` on every seed has an A12 of 0 and a difference below 0."""
    better = contrast(compare_arms(jobs({"none": NONE, "better": BETTER})), "better")
    assert (better.a12, better.cliffs_delta, better.difference) == (0, -1, pytest.approx(-0.1))


def test_runs_of_one_seed_are_held_against_each_other() -> None:
    """Differences by hand: -0.01, 0.01, -0.03, 0.01, -0.03; of a loss, three are better."""
    mixed = contrast(compare_arms(jobs({"none": NONE, "mixed": MIXED})), "mixed")
    assert (mixed.better, mixed.equal, mixed.worse) == (3, 0, 2)
    assert (mixed.by_seed, mixed.by_seed_low, mixed.by_seed_high) == pytest.approx((-0.01, -0.03, 0.01))


def test_only_shared_seeds_are_paired() -> None:
    """Seeds 1 and 2; the test takes all of both."""
    ablation = compare_arms(jobs({"none": {0: 0.5, 1: 0.6, 2: 0.7}, "a": {1: 0.5, 2: 0.7, 3: 0.1}}))
    row = contrast(ablation, "a")
    assert (row.better, row.equal, row.worse) == (1, 1, 0)
    assert row.p == mann_whitney([0.5, 0.7, 0.1], [0.5, 0.6, 0.7]).p


def test_equal_values_are_not_mann_whitney_of() -> None:
    """The same value seed by seed is not a finding of p = 1; other arms are corrected as if it were."""
    ablation = compare_arms(jobs({"none": NONE, "same": NONE, "better": BETTER}))
    same = contrast(ablation, "same")
    assert (same.comparability, same.equal, is_untested(same)) == (Comparability.equal_values, 5, True)
    assert contrast(ablation, "better").p_holm == pytest.approx(2 * 2 / 252)


def test_arm_that_is_the_reference_by_construction_leaves_the_family() -> None:
    """Nothing is tested, and another arm is corrected as if it were not there; with one seed, too."""
    runs = jobs({"none": NONE, "same": NONE, "better": BETTER}, {"none": range(5), "same": range(5)})
    ablation = compare_arms(runs, twins=[("none", "same")])
    same = contrast(ablation, "same")
    assert (same.comparability, same.differing, is_untested(same)) == (Comparability.by_construction, 0, True)
    assert contrast(ablation, "better").p_holm == pytest.approx(2 / 252)
    single = compare_arms(jobs({"none": {0: 0.5}, "same": {0: 0.5}, "other": {0: 0.4}}, {"none": [0], "same": [0]}))
    assert contrast(single, "same").comparability == Comparability.identical
    assert contrast(single, "other").comparability == Comparability.too_few_seeds


#: The runs of three seeds are those of `none`.
HALF = {0: 0.50, 1: 0.42, 2: 0.54, 3: 0.47, 4: 0.58}
ALIKE = {"none": (0, 2, 4), "half": (0, 2, 4)}


def test_run_that_is_the_references_is_not_compared() -> None:
    """Two seeds of five differ, so n is two: U 0 of 4 pairs, p 2 / 6, and the median of two differences."""
    ablation = compare_arms(jobs({"none": NONE, "half": HALF}, ALIKE))
    half = contrast(ablation, "half")
    assert half.differing == 2
    assert (half.u, half.p) == (0, pytest.approx(1 / 3))
    assert half.p == pytest.approx(mannwhitneyu([0.42, 0.47], [0.52, 0.56], method="exact").pvalue)
    assert (half.better, half.equal, half.worse) == (2, 0, 0)
    assert half.by_seed == pytest.approx(-0.095)
    assert Caution.few_seeds in half.cautions
    assert ablation.arms[Metric.best_fitness].n.tolist() == [5, 5]


def test_one_run_that_differs_is_not_mann_whitney_of() -> None:
    """The arm counts in Holm's family as one with p = 1, so the family does not depend on what the runs found."""
    alike = {"none": (0, 1, 2, 3), "once": (0, 1, 2, 3)}
    once = [*NONE[:4], 0.1]
    ablation = compare_arms(jobs({"none": NONE, "once": once, "better": BETTER}, alike))
    assert contrast(ablation, "once").comparability == Comparability.too_few_differ
    assert is_untested(contrast(ablation, "once"))
    assert contrast(ablation, "better").p_holm == pytest.approx(2 * 2 / 252)


def test_costs_do_not_set_runs_apart() -> None:
    """Timings that are lost or were taken twice make no other search of a run."""
    spent = Spending(answers=1, input_tokens=10, output_tokens=5, usd=0.25)
    paid = {"g01s00": spent}
    runs = [run([trained(0, 0), trained(1, 0)], [closed(0), closed(1)], spent=some) for some in (paid, None)]
    assert slots_of(runs[0]) == slots_of(runs[1])
    measured = [finished(arm, 0, one) for arm, one in zip(("none", "a"), runs, strict=True)]
    assert jobs_frame(measured, curves_of(measured)).search.tolist() == [0, 0]


def test_equal_samples_in_another_order_are_mann_whitney_of() -> None:
    """Seeds that changed places are different runs, however alike the samples are."""
    turned = contrast(compare_arms(jobs({"none": NONE, "turned": NONE[::-1]})), "turned")
    assert (turned.comparability, turned.p) == (Comparability.comparable, 1.0)


def test_equal_values_on_shared_seeds_alone_are_mann_whitney_of() -> None:
    """What only one of two arms has is not hidden by what both have: 40 evaluations against 12."""
    arms = {"none": {0: 20, 1: 20, 2: 12, 3: 11}, "a": {0: 20, 1: 20, 4: 40, 5: 41}}
    assert contrast(compare_arms(jobs(arms)), "a").comparability == Comparability.comparable
    longer = compare_arms(jobs({"none": NONE, "more": {**dict(enumerate(NONE)), 5: 9.0}}))
    assert contrast(longer, "more").comparability == Comparability.comparable


def test_one_value_everywhere_is_equal_values() -> None:
    """Also where the arms share no seed: the runs are others, so they are not identical."""
    ablation = compare_arms(jobs({"none": {0: 0.5, 1: 0.5}, "a": {2: 0.5, 3: 0.5}}))
    assert contrast(ablation, "a").comparability == Comparability.equal_values


@pytest.mark.parametrize(("none", "other"), [([0.5], [0.4, 0.3]), ([0.5, 0.6], [0.4]), ([0.5], [0.5])])
def test_single_seed_has_neither_interval_nor_test(none: list[float], other: list[float]) -> None:
    """One run is not a sample, on either side."""
    ablation = compare_arms(jobs({"none": none, "a": other}))
    it = contrast(ablation, "a")
    assert it.comparability == Comparability.too_few_seeds
    assert is_untested(it)
    assert np.isnan(it.by_seed)
    frame = ablation.arms[Metric.best_fitness]
    assert frame.median_low.isna().tolist() == frame.median_high.isna().tolist() == [len(none) < 2, len(other) < 2]
    assert frame["median"].notna().all()


def test_arm_without_enough_seeds_is_no_part_of_the_family() -> None:
    """It has no p, now or later, that others would have to be corrected for."""
    ablation = compare_arms(jobs({"none": NONE, "better": BETTER, "one": [0.1]}))
    assert contrast(ablation, "better").p_holm == pytest.approx(2 / 252)


def test_few_seeds_are_judged_by_every_arms_least_p() -> None:
    """Of 10 and 2 the least is 2 / 66 = 0.030, enough for Holm's last step, after an arm of 10 has taken the first."""
    many, far = [number / 100 for number in range(10)], [1 + number / 100 for number in range(10)]
    one = compare_arms(jobs({"none": many, "far": far, "two": [2.0, 2.1]}))
    two = compare_arms(jobs({"none": many, "far": far, "two": [2.0, 2.1], "too": [2.0, 2.1]}))
    assert contrast(one, "two").p_holm == pytest.approx(2 / 66)
    assert Caution.few_seeds not in contrast(one, "two").cautions
    assert [Caution.few_seeds in contrast(two, name).cautions for name in ("far", "two", "too")] == [False, True, True]


def test_without_the_reference_nothing_is_mann_whitney_of() -> None:
    """Medians and intervals stay."""
    ablation = compare_arms(
        jobs({"none": NONE, "a": BETTER}), requested_reference="b"
    )  # neither `none` nor the first arm replaces it
    assert (ablation.reference, ablation.requested_reference) == (None, "b")
    assert all(frame.comparability.isna().all() and frame.better.isna().all() for frame in ablation.arms.values())
    assert ablation.arms[Metric.best_fitness]["median"].tolist() == [0.54, 0.44]


def test_any_arm_can_be_the_reference() -> None:
    """A sweep over models has no arm called `none`; the test is against the arm that was wanted."""
    ablation = compare_arms(
        jobs({"llm=a": NONE, "llm=b": BETTER, "llm=c": MIXED}), requested_reference="llm=b"
    )  # comes first
    assert (ablation.reference, ablation.names) == ("llm=b", ["llm=b", "llm=a", "llm=c"])
    row = contrast(ablation, "llm=a")
    assert (row.p, row.n_arm, row.n_reference) == (mann_whitney(NONE, BETTER).p, 5, 5)
    assert pd.isna(contrast(ablation, "llm=b").comparability)


def test_score_on_test_images_is_shown_where_a_run_has_one() -> None:
    """Of the task's own metric only; an accuracy is better where it is more."""
    runs = jobs({"none": NONE, "better": BETTER})
    assert TESTED.isdisjoint(compare_arms(runs).arms)
    ablation = compare_arms(runs.assign(test_accuracy=1 - runs.best_fitness))
    assert list(ablation.arms)[:2] == [Metric.test_accuracy, Metric.best_fitness]
    better = contrast(ablation, "better", Metric.test_accuracy)
    assert (better.better, better.worse) == (5, 0)


def test_another_arm_draws_no_numbers_of_this_one() -> None:
    """Each has a stream of its own, so equal values have equal intervals."""
    alone = compare_arms(jobs({"none": NONE, "mixed": MIXED}))
    among = compare_arms(jobs({"none": NONE, "better": BETTER, "mixed": MIXED}))
    first, second = (contrast(ablation, "mixed").drop("p_holm") for ablation in (alone, among))
    assert first.difference_low < first.difference_high
    assert first.equals(second)


def failed_job(arm: str, seed: int) -> Job:
    """Make a job that failed."""
    return Job(name=f"{arm}-seed{seed}", arm=arm, seed=seed, overrides=(), config="")


def test_job_that_failed_counts_as_worse_than_any_other() -> None:
    """An arm whose worst two jobs are lost is not the better for it: as if they had come last, and medians as known."""
    whole = compare_arms(jobs({"none": NONE, "a": [0.40, 0.42, 0.44, 0.60, 0.62]}))
    lost = {"none": NONE, "a": [0.40, 0.42, 0.44]}
    flattered = compare_arms(jobs(lost))
    counted = compare_arms(jobs(lost), failed=[failed_job("a", 3), failed_job("a", 4)])
    by_rank = mann_whitney([1, 2, 3, 9, 9], [4, 5, 6, 7, 8])
    assert contrast(counted, "a").p == by_rank.p
    assert contrast(counted, "a").method == "exact, ties"
    assert contrast(counted, "a").u == contrast(whole, "a").u > contrast(flattered, "a").u
    row, effects = contrast(counted, "a"), ["a12", "a12_low", "a12_high"]
    assert (row.n_arm, row.n_reference, row.differing, row.worse) == (5, 5, 5, 2)
    assert row[effects].equals(contrast(whole, "a")[effects])
    assert row.difference_high <= 0.58 - 0.50  # by the worst value that is known, and no larger one
    assert (row["median"], counted.values("a", Metric.best_fitness)) == (0.42, {0: 0.40, 1: 0.42, 2: 0.44})


def test_arm_that_lost_every_job_is_not_the_better_for_it() -> None:
    """It is last in rank, has no median, and counts in the family; a reference without a run compares with nothing."""
    lost = [failed_job("a", seed) for seed in range(5)]
    ablation = compare_arms(jobs({"none": NONE, "b": BETTER}), failed=lost)
    assert list(ablation.arms[Metric.best_fitness].runs.items()) == [("none", 5), ("b", 5), ("a", 0)]
    assert np.isnan(contrast(ablation, "a")["median"])
    assert contrast(ablation, "a").p == mann_whitney([9] * 5, [1, 2, 3, 4, 5]).p
    assert contrast(ablation, "a").worse == 5
    assert contrast(ablation, "b").p_holm == pytest.approx(2 * 2 / 252)
    assert compare_arms(jobs({"none": NONE}), requested_reference="a", failed=lost).reference is None


def test_reference_that_lost_jobs_is_not_flattered_either() -> None:
    """They count against it."""
    some: dict[str, Sequence[float] | Mapping[int, float]] = {"none": {0: 0.50, 1: 0.52}, "a": [0.51, 0.53, 0.54]}
    ablation = compare_arms(jobs(some), failed=[failed_job("none", 2)])
    assert contrast(ablation, "a").u == 5  # 0.51 above one that is known, two above both; none above the lost
    assert contrast(ablation, "a").better == 1


def test_job_that_failed_is_worst_where_more_is_better() -> None:
    """Below the least accuracy; and it used nothing that could be compared."""
    scores = [0.5] * 5 + [0.9, 0.9, 0.8, 0.8, None]
    made = jobs({"none": NONE, "a": BETTER}).assign(test_accuracy=scores, cost=scores)
    ablation = compare_arms(made, failed=[failed_job("a", 4)])
    sizes = {metric: tuple(contrast(ablation, "a", metric)[["n_arm", "n_reference"]]) for metric in ablation.arms}
    assert sizes[Metric.test_accuracy] == sizes[Metric.best_fitness] == (5, 5)
    assert sizes[Metric.cost] == (4, 5)
    assert contrast(ablation, "a", Metric.test_accuracy).worse == 1
    assert contrast(ablation, "a", Metric.best_fitness).worse == 0


def test_unknown_values_are_left_out() -> None:
    """A run whose tokens nobody wrote down is not a run of 0 tokens."""
    ablation = compare_arms(jobs({"none": NONE, "a": BETTER}))
    assert ablation.arms[Metric.tokens]["median"].isna().all()
    assert contrast(ablation, "a", Metric.tokens).comparability == Comparability.too_few_seeds


def test_run_is_measured_by_hand() -> None:
    """From 0.8 by 0.4 of generation 0 to 0.1; three sources of 10 FLOPs, one twice; half of generation 1 trained."""
    spent = Spending(answers=1, input_tokens=10, output_tokens=5, usd=0.25)
    slots = [
        trained(0, 0, 0.8, descriptors=(0.0, 1.0)),
        trained(0, 1, 0.4),
        trained(1, 0, 0.1, descriptors=(1.0, 1.0)),
        trained(1, 1, 0.4, source="g00s01"),
    ]
    paid = dict.fromkeys(("g00s01", "g01s00", "g01s01"), spent)
    values = values_of(run(slots, [closed(0, 0.4), closed(1, 0.1, candidates=4, trained=2)], spent=paid))
    assert pd.isna([values.pop(metric.name) for metric in TESTED]).all()
    assert values == {
        "best_fitness": 0.1,
        "new_quartile": 0.1,
        "new_median": 0.1,
        "improvement": 0.75,
        "improvement_over_baseline": 0.875,
        "qd_score": pytest.approx(1 / 1.4 + 1 / 1.1),
        "coverage": 1.0,
        "trainable": 0.5,
        "candidates": 4,
        "evaluations": 3,
        "training_flops": pytest.approx(3 * 10 * 8 * 1 / 1e12),
        "tokens": 45,
        "cost": 0.75,
    }


def test_spending_with_a_gap_is_unknown() -> None:
    """One answer that timings do not tell of, or has no price, makes a sum of the rest a lie."""
    known = Spending(answers=1, input_tokens=10, output_tokens=5, usd=0.25)
    slots, lines = [trained(0, 0), trained(1, 0)], [closed(0), closed(1)]
    gap = run([*slots, rejected(1, 1)], lines, spent={"g01s00": known})
    unpriced = run(slots, lines, spent={"g01s00": Spending(answers=1, unpriced=1)})
    assert pd.isna([values_of(gap)["tokens"], values_of(gap)["cost"]]).all()
    assert values_of(unpriced)["tokens"] == 0
    assert np.isnan(values_of(unpriced)["cost"])


def test_run_that_ended_early_stays_where_it_ended() -> None:
    """Curves by generation have a value of every seed, and the figures at the end are its own."""
    ended = [finished("none", 0, run_to(0.5, 0.4, 0.3)), finished("none", 1, run_to(0.6, 0.2))]
    curves = curves_of(ended)
    assert by_generation(curves, "none", Metric.best_fitness).tolist() == [[0.5, 0.4, 0.3], [0.6, 0.2, 0.2]]
    places = by_generation(curves, "none", Metric.qd_score)
    assert places.shape == (2, 3)
    assert places[1, 2] == places[1, 1]
    ablation = compare_arms(jobs_frame(ended, curves))
    assert ablation.values("none", Metric.candidates) == {0: 3, 1: 2}


def test_search_of_generation_0_has_no_trainable_share() -> None:
    """Generation 0 is not a generation of the search."""
    assert np.isnan(values_of(run_to(0.5))["trainable"])


def test_frames_have_the_documented_columns_and_types_whatever_is_known() -> None:
    """A sweep without a test score, a price or a reference has the columns of one with all; missing is not 0 or ''."""
    none = jobs({"none": NONE, "a": BETTER})
    for wanted in ("none", "nobody"):
        ablation = compare_arms(none, requested_reference=wanted)
        for frame, columns in ((ablation.jobs, JOBS), *((frame, ARMS) for frame in ablation.arms.values())):
            assert {name: str(kind) for name, kind in frame.dtypes.items()} == columns
        assert ablation.jobs.tokens.isna().all()
        assert ablation.arms[Metric.tokens].n.tolist() == [0, 0]
