"""The tables of a sweep: all arms in all metrics, each metric against the reference, and every run."""

from collections.abc import Mapping, Sequence

from analysis.ablation import ALPHA, FEWEST_SEEDS, FRACTIONS, LESS_IS_BETTER, Ablation, Arm, Contrast, Metric, Standing
from analysis.effects import LEVEL, RESAMPLES, Interval
from analysis.rounding import shown
from analysis.sweeps import REFERENCE, Missing, Sweep
from analysis.tables import Between, Cell, Percent, PercentBetween, PValue, Table
from tacevo.digits import rounded
from tacevo.plurals import counted, listed

#: What a contrast has, in the order of its columns.
_TESTED = ("U", "p", "p, Holm", "method", "A12", "Cliff's delta")

#: Said of what answers cost.
_SHARED = "Arms share recorded answers, so that a sweep paid less than the sum of its runs."

#: What a metric counts, where its name does not say it.
_MEANINGS = {
    Metric.best_fitness: "Fitness is a validation loss in the units of training.",
    Metric.improvement: "The part of generation 0's best fitness that is gone at the end.",
    Metric.improvement_over_baseline: "The part of the baseline's fitness that is gone at the end.",
    Metric.trainable: "First answers that were trained, mean over the generations from 1 on.",
    Metric.evaluations: "Different sources that were trained, failed trainings among them.",
    Metric.tokens: f"Read and written, of all answers. {_SHARED}",
    Metric.cost: f"Of all answers, by the prices recorded with them. {_SHARED}",
}


def ablation_tables(sweep: Sweep, found: Ablation, niches_of: str) -> tuple[Table, ...]:
    """Give all tables of a sweep.

    Args:
        sweep: what was compared, and what is missing of it.
        found: what `analysis.ablation.compare_arms` says of it.
        niches_of: name of the job whose niches the common archive has.
    """
    metrics = (metric_table(sweep, found, metric, niches_of) for metric in Metric)
    return arms_table(sweep, found, niches_of), *metrics, runs_table(sweep, found, niches_of)


def arms_table(sweep: Sweep, found: Ablation, niches_of: str) -> Table:
    """Show every arm in every metric: median and interval."""
    return Table(
        name=f"ablation_{sweep.task}",
        caption=f"The arms of {sweep.name} ({sweep.task}).",
        columns=("arm", "seeds", *(metric.value for metric in Metric)),
        rows=tuple((arm.name, len(arm.seeds), *(_summary(arm, metric) for metric in Metric)) for arm in found.arms),
        notes=(
            _median_note(found),
            common_note(niches_of),
            *(f"{metric.value}: {_lower_first(words)}" for metric, words in _MEANINGS.items()),
            *_reference_note(found),
            *_missing_note(sweep.missing),
        ),
    )


def metric_table(sweep: Sweep, found: Ablation, metric: Metric, niches_of: str) -> Table:
    """Show every arm in one metric, and how it differs from the reference."""
    unit = " (percentage points)" if metric in FRACTIONS else ""
    counts = ("better", "equal", "worse")
    return Table(
        name=f"ablation_{metric.name}_{sweep.task}",
        caption=f"The arms of {sweep.name} ({sweep.task}): {metric.value}.",
        columns=(
            *("arm", "seeds", "median", *_TESTED),
            *(f"difference of medians{unit}", f"median difference by seed{unit}"),
            *(f"seeds {word}" for word in counts),
        ),
        rows=tuple(_row(arm, metric) for arm in found.arms),
        notes=(
            *([_MEANINGS[metric]] if metric in _MEANINGS else []),
            *([common_note(niches_of)] if metric in {Metric.qd_score, Metric.coverage} else []),
            f"{'Less' if metric in LESS_IS_BETTER else 'More'} is better.",
            _median_note(found),
            *_test_notes(found, metric),
            *_reference_note(found),
            *_missing_note(sweep.missing),
        ),
    )


def runs_table(sweep: Sweep, found: Ablation, niches_of: str) -> Table:
    """Show every run in every metric."""
    return Table(
        name=f"ablation_runs_{sweep.task}",
        caption=f"The runs of {sweep.name} ({sweep.task}).",
        columns=("run", "arm", "seed", *(metric.value for metric in Metric)),
        rows=tuple(
            (one.job, one.arm, one.seed, *(_value(metric, one.values[metric]) for metric in Metric))
            for one in found.outcomes
        ),
        notes=(common_note(niches_of), *_missing_note(sweep.missing)),
    )


def common_note(niches_of: str) -> str:
    """Say what coverage and QD-score were counted in."""
    return (
        "QD-score and coverage are those of one common archive: every trained candidate of a run, in order, in the "
        f"niches of {niches_of} under bounds common to all runs. They are not those of a run's own ledger."
    )


def _row(arm: Arm, metric: Metric) -> tuple[Cell, ...]:
    summary = arm.metrics[metric]
    contrast = summary.contrast
    return (
        arm.name,
        len(summary.values),
        _summary(arm, metric),
        *((None,) * (len(_TESTED) + 5) if contrast is None else _contrast(contrast, metric)),
    )


def _contrast(contrast: Contrast, metric: Metric) -> tuple[Cell, ...]:
    paired = contrast.paired
    differences: tuple[Cell, ...] = (_difference(metric, paired.difference), paired.better, paired.equal, paired.worse)
    test, p_holm, effects = contrast.test, contrast.p_holm, contrast.effects
    if test is None or p_holm is None or effects is None:
        word = contrast.standing.value
        return (None, word, None, None, None, None, None, *differences)
    return (
        int(test.u) if test.u.is_integer() else test.u,
        PValue(test.p),
        PValue(p_holm),
        test.method.value,
        _between(effects.a12),
        _between(effects.cliffs_delta),
        _difference(metric, effects.median_difference),
        *differences,
    )


def _summary(arm: Arm, metric: Metric) -> Cell:
    """Show the median of an arm, with its interval where there is one."""
    summary = arm.metrics[metric]
    if summary.interval is None:
        return _value(metric, summary.median)
    shape = PercentBetween if metric in FRACTIONS else Between
    return shape(summary.interval.estimate, summary.interval.low, summary.interval.high)


def _value(metric: Metric, value: float | None) -> Cell:
    if value is None:
        return None
    return Percent(value) if metric in FRACTIONS else value


def _difference(metric: Metric, interval: Interval | None) -> Cell:
    return None if interval is None else _between(interval, 100 if metric in FRACTIONS else 1)


def _between(interval: Interval, factor: int = 1) -> Between:
    return Between(*(rounded(factor * value) for value in (interval.estimate, interval.low, interval.high)))


def _median_note(found: Ablation) -> str:
    few = [arm.name for arm in found.arms if len(arm.seeds) < FEWEST_SEEDS]
    words = (
        f"Median over seeds; in brackets {100 * LEVEL:g} % percentile intervals of {RESAMPLES:,} bootstrap resamples "
        f"of the seeds.{_range_note(found)}"
    )
    return f"{words} No interval and no test with fewer than {FEWEST_SEEDS} seeds: {listed(few)}." if few else words


def _range_note(found: Ablation) -> str:
    """Say what the interval of few seeds can be trusted with: each lies above the median with a chance of a half."""
    fewest = min((len(arm.seeds) for arm in found.arms if len(arm.seeds) >= FEWEST_SEEDS), default=None)
    if fewest is None or (chance := 1 - 2.0 ** (1 - fewest)) >= LEVEL:
        return ""
    return (
        " None reaches beyond the seeds, whose range holds the median of all seeds with a chance of "
        f"{shown(Percent(chance))} for {fewest} of them."
    )


def _test_notes(found: Ablation, metric: Metric) -> list[str]:
    """Say how the columns beside the median came about; nothing where there is no reference."""
    contrasts = {arm.name: contrast for arm in found.arms if (contrast := arm.metrics[metric].contrast) is not None}
    if not contrasts:
        return []
    family = sum(contrast.standing is not Standing.too_few_seeds for contrast in contrasts.values())
    same = [name for name, contrast in contrasts.items() if contrast.standing is Standing.identical]
    notes = [
        f"p: two-sided Mann-Whitney U of an arm's seeds against those of {REFERENCE}; corrected over "
        f"{counted(family, 'arm')} after Holm, at alpha {ALPHA:g}.",
        f"A12: the chance that a run of the arm has more than one of {REFERENCE}. Differences are arm less "
        f"{REFERENCE}; by seed: of the runs that share a seed, and so their streams.",
    ]
    if same:
        notes.append(
            f"Identical: {listed(same)} and {REFERENCE} have the same values, seed by seed, so there is nothing to "
            "test. In Holm's correction such an arm counts as p = 1."
        )
    return [*notes, *_caution_notes(contrasts)]


def _caution_notes(contrasts: Mapping[str, Contrast]) -> list[str]:
    """Say each caution once, for all arms that it concerns."""
    concerned: dict[str, list[str]] = {}
    for name, contrast in contrasts.items():
        for caution in contrast.cautions:
            concerned.setdefault(caution.value, []).append(name)
    return [f"{listed(names)}: {words}." for words, names in concerned.items()]


def _reference_note(found: Ablation) -> list[str]:
    if found.reference is not None:
        return []
    return [f"There is no test: the sweep has no finished run of the arm {REFERENCE}, which others are compared with."]


def _missing_note(missing: Sequence[Missing]) -> list[str]:
    if not missing:
        return []
    names = listed(one.job.name for one in missing)
    return [f"Missing, {counted(len(missing), 'job')}: {names}. When they are there, every value may change a little."]


def _lower_first(words: str) -> str:
    return words[0].lower() + words[1:]
