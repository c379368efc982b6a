"""The tables of a study: scores, metrics, verdicts and effect sizes."""

from dataclasses import asdict

import numpy as np

from analysis.comparison import Comparisons
from analysis.effects import LEVEL, RESAMPLES, Interval
from analysis.equivalence import MarginKind
from analysis.power import Detectable
from analysis.results import LOWER_IS_BETTER, Network, Study
from analysis.samples import Sample, rounded
from analysis.study_checks import check_study
from analysis.tables import Between, Cell, Percent, PValue, Table
from tacevo.plurals import counted

#: Metrics as a reader knows them; what follows an underscore is an axis, as in `mse_Fx`.
NAMES = {
    "mse": "MSE",
    "mae": "MAE",
    "rmse": "RMSE",
    "r2": "R²",
    "macro_f1": "macro-F1",
    "cross_entropy": "cross-entropy",
}


def study_tables(study: Study, found: Comparisons) -> tuple[Table, ...]:
    """Give all tables of a study.

    Args:
        study: finished.
        found: what `analysis.comparison.compare` says of it.

    Raises:
        RunError: a score is missing or not finite; the message names the rows.
    """
    return scores_table(study), metrics_table(study), verdicts_table(study, found), effects_table(study, found)


def scores_table(study: Study) -> Table:
    """Show how each network's seeds spread in the primary metric; raises as `study_tables` does."""
    metric = study.primary
    check_study(study, metrics=(metric,))
    return Table(
        name=f"scores_{study.task}",
        caption=f"Test {metric_name(metric)} of the networks of {study.task}.",
        columns=("network", "candidate", "parameters", "median", "lower quartile", "upper quartile", "least", "most"),
        rows=tuple(
            (network.name, network.id, network.parameters, *_scores(study, network)) for network in study.networks
        ),
        notes=(_training(study),),
    )


def metrics_table(study: Study) -> Table:
    """Show every metric of every network; raises as `study_tables` does."""
    metrics = tuple(sorted({metric for score in study.scores for metric in score.metrics}))
    check_study(study, metrics=metrics)
    return Table(
        name=f"metrics_{study.task}",
        caption=f"Test metrics of the networks of {study.task}.",
        columns=("network", *map(metric_name, metrics)),
        rows=tuple((network.name, *_medians(study, network, metrics)) for network in study.networks),
        notes=("Median of the seeds, with their lower and upper quartile in brackets.", _training(study)),
    )


def verdicts_table(study: Study, found: Comparisons) -> Table:
    """Show the tests of every variant against the baseline."""
    return Table(
        name=f"verdicts_{study.task}",
        caption=f"The variants of {study.task} against the baseline, test {metric_name(found.metric)}.",
        columns=("network", "median", "U", "p", "p, Holm", "method", "p equal", "p equal, Holm", "verdict"),
        rows=(
            ("baseline", _value(found.metric, found.baseline_median), *(None,) * 7),
            *(
                (
                    variant.network,
                    _value(found.metric, variant.median),
                    int(variant.test.u) if variant.test.u.is_integer() else variant.test.u,
                    PValue(variant.test.p),
                    PValue(variant.p_holm),
                    variant.test.method.value,
                    PValue(variant.equivalence.p),
                    PValue(variant.equivalence_p_holm),
                    variant.verdict.value,
                )
                for variant in found.variants
            ),
        ),
        notes=(*_method_notes(found), *_caution_notes(found)),
    )


def effects_table(study: Study, found: Comparisons) -> Table:
    """Show how large every variant's difference from the baseline is."""
    better = "below" if LOWER_IS_BETTER[found.metric] else "above"
    return Table(
        name=f"effects_{study.task}",
        caption=f"Effect sizes of the variants of {study.task} against the baseline, test {metric_name(found.metric)}.",
        columns=("network", "A12", "Cliff's delta", "difference of medians"),
        rows=tuple(
            (
                variant.network,
                _between(variant.effects.a12),
                _between(variant.effects.cliffs_delta),
                _between(variant.effects.median_difference),
            )
            for variant in found.variants
        ),
        notes=(
            f"In brackets: {100 * LEVEL:g} % percentile intervals of {RESAMPLES:,} bootstrap resamples of the seeds.",
            f"A12 is the chance that a seed of the variant has a larger {metric_name(found.metric)} than one of the "
            f"baseline: {better} 0.5 the variant is the better one.",
            _power_note(found),
        ),
    )


def metric_name(metric: str) -> str:
    """Name a metric for a reader: `mse_Fx` is MSE Fx."""
    head, _, axis = metric.partition("_")
    return NAMES.get(metric) or f"{NAMES.get(head, head)} {axis}".strip()


def _value(metric: str, value: float) -> Cell:
    """Show a score: shares of images as percentages, as the paper does."""
    return value if LOWER_IS_BETTER[metric] else Percent(value)


def _scores(study: Study, network: Network) -> tuple[Cell, ...]:
    return tuple(_value(study.primary, value) for value in _spread(study.values(network.name, study.primary)))


def _spread(values: Sample) -> tuple[float, ...]:
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    return tuple(rounded(float(value)) for value in (middle, low, high, values.min(), values.max()))


def _medians(study: Study, network: Network, metrics: tuple[str, ...]) -> tuple[Cell, ...]:
    spreads = [_spread(study.values(network.name, metric)) for metric in metrics]
    return tuple(Between(median, low, high) for median, low, high, _, _ in spreads)


def _between(interval: Interval) -> Between:
    return Between(**asdict(interval))


def _training(study: Study) -> str:
    return (
        f"{counted(study.seeds, 'training seed')} of each network, {study.recipe.epochs} epochs, weights of the best "
        "validation epoch."
    )


def _method_notes(found: Comparisons) -> tuple[str, ...]:
    margin = found.variants[0].equivalence.margin
    stated = (
        f"{100 * found.margin.value:g} % of the baseline's median, " if found.margin.kind is MarginKind.relative else ""
    )
    return (
        f"p: two-sided Mann-Whitney U of {counted(found.seeds, 'seed')} against as many of the baseline, at "
        f"alpha {found.alpha}; corrected over {counted(len(found.variants), 'variant')} after Holm.",
        f"p equal: two one-sided Mann-Whitney tests against a margin of {stated}{margin:.3g} "
        f"{metric_name(found.metric)}.",
        "Better and worse: p after Holm is at most alpha. Equivalent: it is not, and p equal after Holm is. "
        "Undecided: neither.",
    )


def _caution_notes(found: Comparisons) -> tuple[str, ...]:
    """Say each caution once, for all networks that it concerns."""
    concerned: dict[str, list[str]] = {}
    for variant in found.variants:
        for caution in variant.cautions:
            concerned.setdefault(caution.value, []).append(variant.network)
    return tuple(f"{', '.join(names)}: {words}." for words, names in concerned.items())


def _power_note(found: Comparisons) -> str:
    one, strictest = _detected(found.detectable), _detected(found.detectable_holm)
    return (
        f"With a power of 80 % {counted(found.seeds, 'seed')} detect {one} in a single test, and {strictest} in the "
        "strictest step of Holm's correction."
    )


def _detected(effect: Detectable | None) -> str:
    if effect is None:
        return "no effect at all"
    return f"an A12 of {effect.a12:.2f} or {1 - effect.a12:.2f} ({effect.shift:.2f} standard deviations)"
