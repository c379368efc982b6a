"""Promise: arms are compared by the project's statistics and seed by seed, and never where that is void."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hand_runs import closed, rejected, run, trained
from hand_sweeps import finished, run_to
from scipy.stats import mannwhitneyu

from analysis.runs.run import Run
from analysis.statistics.tests import MannWhitney, holm, mann_whitney
from analysis.studies.warnings import Caution
from analysis.sweeps.ablation import Ablation, Comparability, Contrast, Outcome, compare_arms, outcome
from analysis.sweeps.common_archive import Filled, common_archive
from analysis.sweeps.metrics import Metric
from tacevo.costs import Spending
from tacevo.storage.sweep_directory import Job

NONE = [0.50, 0.52, 0.54, 0.56, 0.58]
BETTER = [0.40, 0.42, 0.44, 0.46, 0.48]
MIXED = [0.49, 0.53, 0.51, 0.57, 0.55]


def outcomes(
    arms: Mapping[str, Sequence[float] | Mapping[int, float]], alike: Mapping[str, Collection[int]] | None = None
) -> list[Outcome]:
    """Make runs of a best fitness each, by the arm's seeds; all other metrics are unknown.

    Runs of equal values are different networks, but for the seeds of an arm that are in `alike`: these are one network.
    """
    alike = alike or {}
    unknown = dict.fromkeys(Metric)
    return [
        Outcome(
            job=f"{arm}-seed{seed}",
            arm=arm,
            seed=seed,
            values={**unknown, Metric.best_fitness: value},
            best=(value,),
            filled=(Filled(coverage=0.5, qd_score=1.0),),
            slots=(trained(0, 0, value, source="one" if seed in alike.get(arm, ()) else arm),),
        )
        for arm, values in arms.items()
        for seed, value in (values.items() if isinstance(values, Mapping) else enumerate(values))
    ]


def contrast(found: Ablation, arm: str, metric: Metric = Metric.best_fitness) -> Contrast:
    """Return an arm's contrast."""
    (it,) = (one.metrics[metric].contrast for one in found.arms if one.name == arm)
    assert it is not None
    return it


def mann_whitney_of(found: Ablation) -> MannWhitney:
    """Return the test of the arm `a`."""
    test = contrast(found, "a").test
    assert test is not None
    return test


def values_of(one: Run) -> Mapping[Metric, float | None]:
    """Measure a run in an archive of its own."""
    job = finished("none", 0, one)
    return outcome(job, common_archive([job.run], job.run, np.array([[0.25, 0.5], [0.75, 0.5]]))).values


def test_tests_are_those_of_the_project() -> None:
    """Mann-Whitney against `none`, with Holm over the arms; by hand, five seeds apart give 2 / 252."""
    found = compare_arms(outcomes({"none": NONE, "better": BETTER, "mixed": MIXED}))
    p_values = [mann_whitney(sample, NONE).p for sample in (BETTER, MIXED)]
    assert p_values[0] == pytest.approx(2 / 252)
    told = [contrast(found, name) for name in ("better", "mixed")]
    assert [one.test.p for one in told if one.test] == p_values
    assert [one.p_holm for one in told] == list(holm(p_values))


def test_effects_have_the_arm_first() -> None:
    """An arm below `none` on every seed has an A12 of 0 and a difference below 0."""
    effects = contrast(compare_arms(outcomes({"none": NONE, "better": BETTER})), "better").effects
    assert effects is not None
    assert (effects.a12.estimate, effects.cliffs_delta.estimate) == (0, -1)
    assert effects.median_difference.estimate == pytest.approx(-0.1)


def test_runs_of_one_seed_are_held_against_each_other() -> None:
    """Differences by hand: -0.01, 0.01, -0.03, 0.01, -0.03; of a loss, three are better."""
    paired = contrast(compare_arms(outcomes({"none": NONE, "mixed": MIXED})), "mixed").paired
    assert (paired.better, paired.equal, paired.worse) == (3, 0, 2)
    assert paired.difference is not None
    assert paired.difference.estimate == pytest.approx(-0.01)
    assert (paired.difference.low, paired.difference.high) == pytest.approx((-0.03, 0.01))


def test_only_shared_seeds_are_paired() -> None:
    """Seeds 1 and 2; the test takes all of both."""
    found = compare_arms(outcomes({"none": {0: 0.5, 1: 0.6, 2: 0.7}, "a": {1: 0.5, 2: 0.7, 3: 0.1}}))
    paired = contrast(found, "a").paired
    assert (paired.better, paired.equal, paired.worse) == (1, 1, 0)
    test = contrast(found, "a").test
    assert test is not None
    assert test.p == mann_whitney([0.5, 0.7, 0.1], [0.5, 0.6, 0.7]).p


def test_identical_values_are_not_mann_whitney_of() -> None:
    """The same network archive seed by seed is not a finding of p = 1; other arms are corrected as if it were."""
    found = compare_arms(outcomes({"none": NONE, "same": NONE, "better": BETTER}))
    same = contrast(found, "same")
    assert (same.comparability, same.test, same.p_holm, same.effects) == (Comparability.identical, None, None, None)
    assert same.paired.equal == 5
    assert contrast(found, "better").p_holm == pytest.approx(2 * 2 / 252)


#: The runs of three seeds are those of `none`.
HALF = {0: 0.50, 1: 0.42, 2: 0.54, 3: 0.47, 4: 0.58}
ALIKE = {"none": (0, 2, 4), "half": (0, 2, 4)}


def test_run_that_is_the_references_is_not_compared() -> None:
    """Two seeds of five differ, so n is two: U 0 of 4 pairs, p 2 / 6, and the median of two differences."""
    found = compare_arms(outcomes({"none": NONE, "half": HALF}, ALIKE))
    half = contrast(found, "half")
    assert half.differing == 2
    assert half.test is not None
    assert half.test.u == 0
    assert half.test.p == pytest.approx(1 / 3)
    assert half.test.p == pytest.approx(mannwhitneyu([0.42, 0.47], [0.52, 0.56], method="exact").pvalue)
    assert (half.paired.better, half.paired.equal, half.paired.worse) == (2, 0, 0)
    assert half.paired.difference is not None
    assert half.paired.difference.estimate == pytest.approx(-0.095)
    assert Caution.few_seeds in half.cautions
    assert [len(arm.metrics[Metric.best_fitness].values) for arm in found.arms] == [5, 5]


def test_one_run_that_differs_is_not_mann_whitney_of() -> None:
    """The arm counts in Holm's family as one with p = 1, so the family does not depend on what the runs found."""
    alike = {"none": (0, 1, 2, 3), "once": (0, 1, 2, 3)}
    once = [*NONE[:4], 0.1]
    found = compare_arms(outcomes({"none": NONE, "once": once, "better": BETTER}, alike))
    assert contrast(found, "once").comparability is Comparability.too_few_differ
    assert contrast(found, "once").test is None
    assert contrast(found, "better").p_holm == pytest.approx(2 * 2 / 252)


def test_costs_do_not_set_runs_apart() -> None:
    """Timings that are lost or were taken twice make no other search of a run."""
    spent = Spending(answers=1, input_tokens=10, output_tokens=5, usd=0.25)
    paid = {"g01s00": spent}
    runs = [run([trained(0, 0), trained(1, 0)], [closed(0), closed(1)], spent=some) for some in (paid, None)]
    common = common_archive(runs, finished("none", 0, runs[0]).run, np.array([[0.25, 0.5], [0.75, 0.5]]))
    first, second = (outcome(finished("none", 0, one), common).slots for one in runs)
    assert first == second


def test_equal_samples_in_another_order_are_mann_whitney_of() -> None:
    """Seeds that changed places are different runs, however alike the samples are."""
    found = contrast(compare_arms(outcomes({"none": NONE, "turned": NONE[::-1]})), "turned")
    assert found.comparability is Comparability.comparable
    assert found.test is not None
    assert found.test.p == 1.0


def test_equal_values_on_shared_seeds_alone_are_mann_whitney_of() -> None:
    """What only one of two arms has is not hidden by what both have: 40 evaluations against 12."""
    arms = {"none": {0: 20, 1: 20, 2: 12, 3: 11}, "a": {0: 20, 1: 20, 4: 40, 5: 41}}
    assert contrast(compare_arms(outcomes(arms)), "a").comparability is Comparability.comparable
    longer = compare_arms(outcomes({"none": NONE, "more": {**dict(enumerate(NONE)), 5: 9.0}}))
    assert contrast(longer, "more").comparability is Comparability.comparable


def test_one_value_everywhere_is_identical() -> None:
    """Also where the arms share no seed."""
    found = compare_arms(outcomes({"none": {0: 0.5, 1: 0.5}, "a": {2: 0.5, 3: 0.5}}))
    assert contrast(found, "a").comparability is Comparability.identical


@pytest.mark.parametrize(("none", "other"), [([0.5], [0.4, 0.3]), ([0.5, 0.6], [0.4]), ([0.5], [0.5])])
def test_single_seed_has_neither_interval_nor_test(none: list[float], other: list[float]) -> None:
    """One run is not a sample, on either side."""
    found = compare_arms(outcomes({"none": none, "a": other}))
    it = contrast(found, "a")
    assert (it.comparability, it.test, it.effects, it.paired.difference) == (
        Comparability.too_few_seeds,
        None,
        None,
        None,
    )
    intervals = [arm.metrics[Metric.best_fitness].interval for arm in found.arms]
    assert [interval is None for interval in intervals] == [len(none) < 2, len(other) < 2]


def test_arm_without_enough_seeds_is_no_part_of_the_family() -> None:
    """It has no p, now or later, that others would have to be corrected for."""
    found = compare_arms(outcomes({"none": NONE, "better": BETTER, "one": [0.1]}))
    assert contrast(found, "better").p_holm == pytest.approx(2 / 252)


def test_few_seeds_are_judged_by_every_arms_least_p() -> None:
    """Of 10 and 2 the least is 2 / 66 = 0.030, enough for Holm's last step, after an arm of 10 has taken the first."""
    many, far = [number / 100 for number in range(10)], [1 + number / 100 for number in range(10)]
    one = compare_arms(outcomes({"none": many, "far": far, "two": [2.0, 2.1]}))
    two = compare_arms(outcomes({"none": many, "far": far, "two": [2.0, 2.1], "too": [2.0, 2.1]}))
    assert contrast(one, "two").p_holm == pytest.approx(2 / 66)
    assert Caution.few_seeds not in contrast(one, "two").cautions
    assert [Caution.few_seeds in contrast(two, name).cautions for name in ("far", "two", "too")] == [False, True, True]


def test_without_the_reference_nothing_is_mann_whitney_of() -> None:
    """Medians and intervals stay."""
    found = compare_arms(outcomes({"temperature=fixed": NONE, "temperature=stall": BETTER}))
    assert found.reference is None
    assert all(summary.contrast is None for arm in found.arms for summary in arm.metrics.values())
    assert [arm.metrics[Metric.best_fitness].median for arm in found.arms] == [0.54, 0.44]


def test_reference_comes_first() -> None:
    """Wherever it stands among the jobs; the others keep their order."""
    found = compare_arms(outcomes({"z": NONE, "none": NONE, "a": NONE}))
    assert [arm.name for arm in found.arms] == ["none", "z", "a"]


def test_any_arm_can_be_the_reference() -> None:
    """A sweep over models has no arm called `none`; the test is against the arm that was wanted."""
    found = compare_arms(outcomes({"llm=a": NONE, "llm=b": BETTER, "llm=c": MIXED}), wanted="llm=b")
    assert (found.reference, [arm.name for arm in found.arms]) == ("llm=b", ["llm=b", "llm=a", "llm=c"])
    test = contrast(found, "llm=a").test
    assert test is not None
    assert test.p == mann_whitney(NONE, BETTER).p
    assert contrast(found, "llm=a").sizes == (5, 5)
    assert found.arms[0].metrics[Metric.best_fitness].contrast is None


def test_reference_without_a_run_is_not_replaced_by_another() -> None:
    """Neither by `none` nor by the first arm."""
    found = compare_arms(outcomes({"none": NONE, "a": BETTER}), wanted="b")
    assert (found.reference, found.wanted) == (None, "b")
    assert all(summary.contrast is None for arm in found.arms for summary in arm.metrics.values())


def test_score_on_test_images_is_shown_where_a_run_has_one() -> None:
    """Of the task's own metric only; an accuracy is better where it is more."""
    runs = outcomes({"none": NONE, "better": BETTER})
    assert {Metric.test_mse, Metric.test_accuracy}.isdisjoint(compare_arms(runs).metrics)
    scored = [
        replace(one, values={**one.values, Metric.test_accuracy: 1 - value})
        for one in runs
        if (value := one.values[Metric.best_fitness]) is not None
    ]
    found = compare_arms(scored)
    assert found.metrics[:2] == (Metric.test_accuracy, Metric.best_fitness)
    paired = contrast(found, "better", Metric.test_accuracy).paired
    assert (paired.better, paired.worse) == (5, 0)


def test_another_arm_draws_no_numbers_of_this_one() -> None:
    """Each has a stream of its own, so equal values have equal intervals."""
    alone = compare_arms(outcomes({"none": NONE, "mixed": MIXED}))
    among = compare_arms(outcomes({"none": NONE, "better": BETTER, "mixed": MIXED}))
    assert alone.arms[1].metrics[Metric.best_fitness].interval == among.arms[2].metrics[Metric.best_fitness].interval
    assert contrast(alone, "mixed").effects == contrast(among, "mixed").effects
    assert contrast(alone, "mixed").paired == contrast(among, "mixed").paired


def failed_job(arm: str, seed: int) -> Job:
    """Make a job that failed."""
    return Job(name=f"{arm}-seed{seed}", arm=arm, seed=seed, overrides=(), config="")


def test_job_that_failed_counts_as_worse_than_any_other() -> None:
    """An arm whose worst two jobs are lost is not the better for it: as if they had come last, and medians as known."""
    whole = compare_arms(outcomes({"none": NONE, "a": [0.40, 0.42, 0.44, 0.60, 0.62]}))
    lost = {"none": NONE, "a": [0.40, 0.42, 0.44]}
    flattered = compare_arms(outcomes(lost))
    counted = compare_arms(outcomes(lost), failed=[failed_job("a", 3), failed_job("a", 4)])
    by_rank = mann_whitney([1, 2, 3, 9, 9], [4, 5, 6, 7, 8])
    assert (mann_whitney_of(counted).p, mann_whitney_of(counted).ties) == (by_rank.p, 2)
    assert mann_whitney_of(counted).u == mann_whitney_of(whole).u > mann_whitney_of(flattered).u
    assert contrast(counted, "a").sizes == (5, 5)
    assert contrast(counted, "a").differing == 5
    assert contrast(counted, "a").paired.worse == 2
    effects, others = contrast(counted, "a").effects, contrast(whole, "a").effects
    assert effects is not None
    assert others is not None
    assert effects.a12 == others.a12
    assert effects.median_difference.high <= 0.58 - 0.50  # by the worst value that is known, and no larger one
    (summary,) = (arm.metrics[Metric.best_fitness] for arm in counted.arms if arm.name == "a")
    assert (summary.median, summary.values) == (0.42, {0: 0.40, 1: 0.42, 2: 0.44})


def test_arm_that_lost_every_job_is_not_the_better_for_it() -> None:
    """It is last in rank, has no median, and counts in the family; a reference without a run compares with nothing."""
    lost = [failed_job("a", seed) for seed in range(5)]
    found = compare_arms(outcomes({"none": NONE, "b": BETTER}), failed=lost)
    assert [(arm.name, len(arm.seeds)) for arm in found.arms] == [("none", 5), ("b", 5), ("a", 0)]
    assert found.arms[2].metrics[Metric.best_fitness].median is None
    assert mann_whitney_of(found).p == mann_whitney([9] * 5, [1, 2, 3, 4, 5]).p
    assert contrast(found, "a").paired.worse == 5
    assert contrast(found, "b").p_holm == pytest.approx(2 * 2 / 252)
    assert compare_arms(outcomes({"none": NONE}), wanted="a", failed=lost).reference is None


def test_reference_that_lost_jobs_is_not_flattered_either() -> None:
    """They count against it."""
    some: dict[str, Sequence[float] | Mapping[int, float]] = {"none": {0: 0.50, 1: 0.52}, "a": [0.51, 0.53, 0.54]}
    found = compare_arms(outcomes(some), failed=[failed_job("none", 2)])
    assert mann_whitney_of(found).u == 5  # 0.51 above one that is known, two above both; none above the lost
    assert contrast(found, "a").paired.better == 1


def test_job_that_failed_is_worst_where_more_is_better() -> None:
    """Below the least accuracy; and it used nothing that could be compared."""
    scores = [0.5] * 5 + [0.9, 0.9, 0.8, 0.8, None]
    made = [
        replace(one, values={**one.values, Metric.test_accuracy: score, Metric.cost: score})
        for one, score in zip(outcomes({"none": NONE, "a": BETTER}), scores, strict=True)
    ]
    found = compare_arms(made, failed=[failed_job("a", 4)])
    assert contrast(found, "a", Metric.test_accuracy).sizes == (5, 5)
    assert contrast(found, "a", Metric.test_accuracy).paired.worse == 1
    assert contrast(found, "a", Metric.cost).sizes == (4, 5)
    assert contrast(found, "a", Metric.best_fitness).sizes == (5, 5)
    assert contrast(found, "a", Metric.best_fitness).paired.worse == 0


def test_unknown_values_are_left_out() -> None:
    """A run whose tokens nobody wrote down is not a run of 0 tokens."""
    found = compare_arms(outcomes({"none": NONE, "a": BETTER}))
    assert found.arms[0].metrics[Metric.tokens].median is None
    assert contrast(found, "a", Metric.tokens).comparability is Comparability.too_few_seeds


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
    assert values == {
        Metric.test_mse: None,
        Metric.test_accuracy: None,
        Metric.best_fitness: 0.1,
        Metric.improvement: 0.75,
        Metric.improvement_over_baseline: 0.875,
        Metric.qd_score: pytest.approx(1 / 1.4 + 1 / 1.1),
        Metric.coverage: 1.0,
        Metric.trainable: 0.5,
        Metric.candidates: 4,
        Metric.evaluations: 3,
        Metric.training_flops: pytest.approx(3 * 10 * 8 * 1 / 1e12),
        Metric.tokens: 45,
        Metric.cost: 0.75,
    }


def test_spending_with_a_gap_is_unknown() -> None:
    """One answer that timings do not tell of, or has no price, makes a sum of the rest a lie."""
    known = Spending(answers=1, input_tokens=10, output_tokens=5, usd=0.25)
    slots, lines = [trained(0, 0), trained(1, 0)], [closed(0), closed(1)]
    gap = run([*slots, rejected(1, 1)], lines, spent={"g01s00": known})
    unpriced = run(slots, lines, spent={"g01s00": Spending(answers=1, unpriced=1)})
    assert (values_of(gap)[Metric.tokens], values_of(gap)[Metric.cost]) == (None, None)
    assert (values_of(unpriced)[Metric.tokens], values_of(unpriced)[Metric.cost]) == (0, None)


def test_run_that_ended_early_stays_where_it_ended() -> None:
    """Curves by generation have a value of every seed, and the figures at the end are its own."""
    jobs = [finished("none", 0, run_to(0.5, 0.4, 0.3)), finished("none", 1, run_to(0.6, 0.2))]
    common = common_archive([job.run for job in jobs], jobs[0].run, np.array([[0.25, 0.5], [0.75, 0.5]]))
    found = compare_arms([outcome(job, common) for job in jobs])
    assert [one.best for one in found.outcomes] == [(0.5, 0.4, 0.3), (0.6, 0.2, 0.2)]
    assert [len(one.filled) for one in found.outcomes] == [3, 3]
    assert found.outcomes[1].filled[2] == found.outcomes[1].filled[1]
    assert found.arms[0].metrics[Metric.candidates].values == {0: 3, 1: 2}


def test_search_of_generation_0_has_no_trainable_share() -> None:
    """Generation 0 is not a generation of the search."""
    assert values_of(run_to(0.5))[Metric.trainable] is None
