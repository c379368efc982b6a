"""The tables of a study: scores, metrics, verdicts and effect sizes."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from analysis.rounding import shown
from analysis.statistics.effects import LEVEL, RESAMPLES, effects_of_constant
from analysis.statistics.samples import Sample
from analysis.studies.ceiling import chance_at
from analysis.studies.comparison import Verdict, deciding_p, late, of_whole
from analysis.studies.metric_names import SHARES, metric_name, named_metrics, recorded_scale, recorded_unit
from analysis.studies.warnings import caution_notes, power_note
from analysis.table import Cell, HalfInteger, Interval, Layout, Percent, PercentInterval, PValue, Table
from analysis.tables.choice import chosen_note
from analysis.tables.followed_plan import plan_notes
from tacevo.choices import ChosenBy, MarginKind
from tacevo.records import Kind
from tacevo.results.study import LOWER_IS_BETTER, RecordedStudy
from tacevo.results.trivial import at_chance, trivial_metrics, trivial_score
from tacevo.rounding import rounded
from tacevo.text import counted, listed

#: What a reader of a study on one data set has to know.
ONE_SPLIT = (
    "One split of one data set: another split, sensor or light may turn a verdict. The same networks are "
    "studied on another by: tacevo study RUN data.split_seed=N."
)

_SEEDLESS = "It has no seeds: intervals are Wilson's of A12, and the sign test's of the difference."

_FREQUENCIES = "Its cross-entropy is that of the class frequencies: a wrong certainty has an infinite one."


def study_tables(
    study: RecordedStudy, comparisons: pd.DataFrame | None, *, is_alone: bool = False
) -> tuple[Table, ...]:
    """Return all tables of a study.

    Without comparisons, where it cannot be compared, these are the tables of its scores only. `is_alone`: its networks
    were studied on these data only, which the tables of scores and verdicts then warn of.
    """
    warning = (ONE_SPLIT,) if is_alone else ()
    if study.choose is ChosenBy.validated:  # of noise runs, tables of earlier releases say nothing
        warning = (*warning, *chosen_note(study))
    scores = scores_table(study)
    tables = [replace(scores, notes=(*scores.notes, *warning, *plan_notes(study.plan))), metrics_table(study)]
    if comparisons is not None:
        verdicts = verdicts_table(study, comparisons)
        tables += [replace(verdicts, notes=(*verdicts.notes, *warning)), effects_table(study, comparisons)]
    if comparisons is not None and comparisons.output.notna().any():
        tables.append(outputs_table(study, comparisons))
    return tuple(tables)


def scores_table(study: RecordedStudy) -> Table:
    """Show each network, its cost, and how its seeds spread in the primary metric."""
    spread, trivial = ("median", "lower quartile", "upper quartile", "least", "most"), trivial_score(study)
    return Table(
        name="scores",
        caption=f"Test {metric_name(study.primary)} of the networks of {study.task}.",
        columns=("network", "candidate", "parameters", "FLOPs", *spread, "chosen epoch"),
        rows=(
            *(
                (
                    *(network.name, network.id, network.parameters, network.flops),
                    *(score_cell(study.primary, value) for value in _spread(study.values(network.name, study.primary))),
                    quartiles([one.epoch for one in study.scores if one.network == network.name]),
                )
                for network in study.networks
            ),
            *([] if trivial is None else [("trivial", None, 0, 0, score_cell(study.primary, trivial), *(None,) * 5)]),
            *([("ceiling", None, None, None, Percent(study.ceiling), *(None,) * 5)] if study.ceiling else []),
        ),
        notes=(
            *at_chance(study),
            *_scale_note(study),
            *_trivial_note(study),
            *ceiling_note(study),
            "FLOPs: of one image, forwards. Chosen epoch: median of the seeds, quartiles in brackets.",
            _training(study),
        ),
    )


def metrics_table(study: RecordedStudy) -> Table:
    """Show every metric of every network, one a row: a task of three outputs has 22."""
    trivial = trivial_metrics(study)
    return Table(
        name="metrics",
        caption=f"Test metrics of the networks of {study.task}.",
        columns=("metric", *(network.name for network in study.networks), *(("trivial",) if trivial else ())),
        rows=tuple(
            (
                *(
                    name,
                    *(
                        quartiles(study.values(network.name, metric), is_share=metric in SHARES)
                        for network in study.networks
                    ),
                ),
                *((score_cell(metric, trivial.get(metric)),) if trivial else ()),
            )
            for metric, name in named_metrics(study)
        ),
        notes=(
            "Median of the seeds, with their lower and upper quartile in brackets.",
            *_scale_note(study),
            *_trivial_note(study),
            *([_FREQUENCIES] if "cross_entropy" in trivial else []),
            _training(study),
        ),
    )


def verdicts_table(study: RecordedStudy, comparisons: pd.DataFrame) -> Table:
    """Show the tests of every variant against the baseline."""
    variants = of_whole(comparisons)
    shape = (Percent, "median") if study.primary in SHARES else "median"
    return Table.of(
        _beside(study, variants, study.primary, trivial_score(study)),
        {"network": "network", "median": shape, **_TEST, "method": "method", **_EQUIVALENCE}
        | {"method, equivalence": "method_equivalence", "verdict": "verdict"},
        name="verdicts",
        caption=f"The variants of {study.task} against the baseline, test {metric_name(study.primary)}.",
        notes=(
            *at_chance(study),
            *_scale_note(study),
            *_mean_note(study, comparisons),
            *_method_notes(study, variants),
            *_small_note(study, variants),
            *caution_notes(zip(variants.network, variants.cautions, strict=True)),
            *_image_note(study, variants),
            *_late_note(study),
            *_trivial_note(study),
            *ceiling_note(study),
        ),
    )


def ceiling_note(study: RecordedStudy) -> tuple[str, ...]:
    """Say what no network can exceed on these data, where it is known."""
    if study.ceiling is None:
        return ()
    images = study.data.counts[2]
    low, high = chance_at(study.ceiling, images)
    return (
        f"Ceiling: {shown(Percent(study.ceiling))}, the accuracy of an observer who sees the width of every ridge, "
        f"which errs and alone tells the class. On {counted(images, 'test image')} chance leaves it between "
        f"{shown(Percent(low))} and {shown(Percent(high))}.",
    )


def _beside(study: RecordedStudy, variants: pd.DataFrame, metric: str, trivial: float | None) -> pd.DataFrame:
    """Return variants between the baseline and the trivial predictor, which have a median alone."""
    baseline = study.networks[0].name
    ends = {"output": variants.output.iloc[0], "network": "trivial", "median": trivial}
    first = ends | {"network": baseline, "median": rounded(float(np.median(study.values(baseline, metric))))}
    return pd.DataFrame([first, *variants.to_dict("records"), *([] if trivial is None else [ends])])


def effects_table(study: RecordedStudy, comparisons: pd.DataFrame) -> Table:
    """Show how large every variant's difference from the baseline is."""
    better, score = "below" if LOWER_IS_BETTER[study.primary] else "above", trivial_score(study)
    baseline, variants, metric = study.networks[0].name, of_whole(comparisons), metric_name(study.primary)
    rows = variants.to_dict("records")
    if score is not None:
        rows.append({"network": "trivial"} | effects_of_constant(score, study.values(baseline, study.primary)))
    difference = f"difference of medians ({unit_of(study.primary)})"
    return Table.of(
        pd.DataFrame(rows),
        {
            "network": "network",
            **EFFECTS_LAYOUT,
            difference: scaled("difference", 100 if study.primary in SHARES else 1),
        },
        name="effects",
        caption=f"Effect sizes of the variants of {study.task} against the baseline, test {metric}.",
        notes=(
            *_scale_note(study),
            f"In brackets: {100 * LEVEL:g} % intervals, by Newcombe's method 5 (2006) of A12 and Cliff's delta, by the "
            f"percentiles of {RESAMPLES:,} bootstrap resamples of the seeds of the difference of medians.",
            f"A12 is the chance that a seed of the variant has a larger {metric} than one of the "
            f"baseline: {better} 0.5 the variant is the better one.",
            power_note(
                counted(study.seeds, "seed"),
                study.seeds,
                study.seeds,
                alpha=study.terms.alpha,
                family=len(study.networks) - 1,
            ),
            *_trivial_note(study),
            *([] if score is None else [_SEEDLESS]),
        ),
    )


def outputs_table(study: RecordedStudy, comparisons: pd.DataFrame) -> Table:
    """Show how every variant does on each output: the primary metric is the mean over them."""
    each, metric, scale = comparisons[comparisons.output.notna()], metric_name(study.primary), recorded_scale(study)
    names, trivial = {name: f"{study.primary}_{name}" for name in each.output}, trivial_metrics(study)
    frame = pd.concat(
        _beside(study, each[each.output == name], of_output, trivial.get(of_output))
        for name, of_output in names.items()
    )
    medians = [rounded(scale[name] ** 2 * median) for name, median in zip(frame.output, frame["median"], strict=True)]
    head = f"median ({metric}, {recorded_unit(study)})"
    return Table.of(
        frame.assign(median=medians),
        {"output": "output", "network": "network", head: "median", "A12": EFFECTS_LAYOUT["A12"], **_TEST}
        | {**_EQUIVALENCE, "verdict": "verdict"},
        name="outputs",
        caption=f"The variants of {study.task} against the baseline on each output, test {metric}.",
        notes=(
            *_scale_note(study),
            f"p and p, equivalence: the tests of the verdicts on the mean; corrected after Holm over all "
            f"{counted(len(each), 'pair')} of output and variant, because a reader may pick any of them. The margin is "
            f"{_margin_of_outputs(study, of_whole(comparisons))}.",
            f"A12: in brackets its {100 * LEVEL:g} % interval; below 0.5 the variant is the better one.",
            *_left_out_note(study, comparisons),
            *caution_notes(
                (f"{network} on {name}", told)
                for network, name, told in zip(each.network, each.output, each.cautions, strict=True)
            ),
            *_late_note(study),
            *_trivial_note(study),
        ),
    )


def score_cell(metric: str, value: float | None) -> Cell:
    """Show a score: shares of images as percentages, as the paper does."""
    return Percent(value) if metric in SHARES and value is not None else value


def unit_of(metric: str) -> str:
    """Name what a difference of a metric is counted in."""
    return "percentage points" if metric in SHARES else metric_name(metric)


def _trivial_note(study: RecordedStudy) -> tuple[str, ...]:
    if trivial_score(study) is None:
        return ()
    always = "the most frequent class" if study.kind is Kind.classification else "the mean"
    return (f"Trivial: looks at no image, and always predicts {always} of the test images.",)


def _spread(values: Sample) -> tuple[float, ...]:
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    return tuple(rounded(float(value)) for value in (middle, low, high, values.min(), values.max()))


#: The columns of a test, and those of the test of equivalence.
_TEST: Layout = {"U": (HalfInteger, "u"), "p": (PValue, "p"), "p, Holm": (PValue, "p_holm")}
_EQUIVALENCE: Layout = {
    "p, equivalence": (PValue, "p_equivalence"),
    "p, equivalence, Holm": (PValue, "p_equivalence_holm"),
}

#: The columns of effect sizes that have no unit.
EFFECTS_LAYOUT: Layout = {
    name: (Interval, *(f"{key}{end}" for end in ("", "_low", "_high")))
    for name, key in (("A12", "a12"), ("Cliff's delta", "cliffs_delta"))
}


def scaled(name: str, factor: float) -> tuple[Any, ...]:
    """Return the shape of an interval's column that is multiplied by a factor."""
    return lambda *ends: Interval(*(rounded(factor * end) for end in ends)), name, f"{name}_low", f"{name}_high"


def quartiles(values: Sequence[float] | Sample, *, is_share: bool = False) -> Cell:
    """Return the cell of a median between the lower and the upper quartile."""
    low, middle, high = (rounded(float(value)) for value in np.quantile(values, [0.25, 0.5, 0.75]))
    return (PercentInterval if is_share else Interval)(middle, low, high)


def _scale_note(study: RecordedStudy) -> tuple[str, ...]:
    """Name the unit of errors; a share of images needs none."""
    if study.kind is Kind.classification:
        return ()
    return ("Errors without a unit are in the scaled units of training.",)


def _training(study: RecordedStudy) -> str:
    return (
        f"{counted(study.seeds, 'training seed')} of each network, {counted(study.recipe.epochs, 'epoch')}, weights of "
        f"the best validation epoch. {study.apart}".rstrip()
    )


def _method_notes(study: RecordedStudy, variants: pd.DataFrame) -> tuple[str, ...]:
    return (
        f"p: two-sided Mann-Whitney U of {counted(study.seeds, 'seed')} against as many of the baseline, at "
        f"alpha {study.terms.alpha:g}; corrected over {counted(len(variants), 'variant')} after Holm.",
        f"p, equivalence: two one-sided Mann-Whitney tests against a margin of {_margin(study, variants)}, as the "
        "study's header states it.",
        "Better and worse: p after Holm is at most alpha, and the interval of A12 does not hold 0.5. Equivalent: that "
        "is not so, and p of equivalence after Holm is at most alpha. Undecided: neither.",
    )


def margin_in_words(study: RecordedStudy, width: float) -> str:
    """Write how wide a margin is: `1 pt` of a share of images, or in the unit of training."""
    return f"{100 * width:.3g} pt" if study.primary in SHARES else shown(width)


def verdict_in_words(study: RecordedStudy, comparison: Any) -> str:
    """Write the word of a comparison with the p of the test that gave it: `equivalent (0.014, margin 1 pt)`."""
    p = shown(PValue(deciding_p(comparison)))
    margin = f", margin {margin_in_words(study, comparison.margin)}"
    return f"{comparison.verdict} ({p}{margin if comparison.verdict == Verdict.equivalent else ''})"


def _margin(study: RecordedStudy, variants: pd.DataFrame) -> str:
    """Write the margin as it was stated, and as wide as it is."""
    width = variants.margin.iloc[0]
    wide = f"{shown(100.0 * width if study.primary in SHARES else width)} {unit_of(study.primary)}"
    if study.terms.margin.kind is MarginKind.absolute:
        return wide
    of = "errors" if study.terms.margin.kind is MarginKind.errors else "median"
    return f"{shown(Percent(study.terms.margin.value))} of the baseline's {of}, {wide}"


def _margin_of_outputs(study: RecordedStudy, variants: pd.DataFrame) -> str:
    """Write the margin of every output: a relative one is as wide as the output's own error makes it."""
    if study.terms.margin.kind is MarginKind.absolute:
        return f"that of the mean, {_margin(study, variants)}"
    return f"{shown(Percent(study.terms.margin.value))} of the baseline's median on that output"


def _mean_note(study: RecordedStudy, comparisons: pd.DataFrame) -> tuple[str, ...]:
    if comparisons.output.isna().all():
        return ()
    return (
        f"{metric_name(study.primary)} is the mean over the outputs; verdicts on each stand in the table of outputs.",
    )


def _left_out_note(study: RecordedStudy, comparisons: pd.DataFrame) -> tuple[str, ...]:
    left_out = [name for name in study.names if name not in set(comparisons.output)]
    if not left_out:
        return ()
    return (f"Not compared on {listed(left_out)}: the baseline's median error is 0, so there is no relative margin.",)


def _small_note(study: RecordedStudy, variants: pd.DataFrame) -> tuple[str, ...]:
    """Name the variants of which a difference was shown that is smaller than the margin."""
    differ = variants.verdict.isin([Verdict.better, Verdict.worse])
    small = variants[differ & (variants.p_equivalence_holm <= study.terms.alpha)]
    if small.empty:
        return ()
    words = listed(f"{one.network} ({one.verdict})" for one in small.itertuples())
    return (f"Equivalent by the margin as well: {words}. A difference was shown that is smaller than the margin.",)


def _image_note(study: RecordedStudy, variants: pd.DataFrame) -> tuple[str, ...]:
    """Warn of a margin that no change of an accuracy fits in: less than one test image, or one group of them."""
    confusion = study.scores[0].confusion
    units = study.data.units if study.data.is_grouped else sum(map(sum, confusion or ()))
    least = 0.0 if confusion is None else rounded(1 / units)
    if variants.margin.iloc[0] >= least:
        return ()
    one, share = ("group", "on average ") if study.data.is_grouped else ("image", "")
    return (
        f"The margin of equivalence is less than one test {one}, {share}{shown(100 * least)} percentage points: a "
        f"network that errs on one {one} more or less lies outside it.",
    )


def _late_note(study: RecordedStudy) -> tuple[str, ...]:
    """Warn of trainings that may have ended too early, with their share of each network's."""
    parts = late(study)
    if not any(parts.values()):
        return ()
    shares = listed(f"{name} {shown(Percent(share))}" for name, share in parts.items())
    return (
        f"Best epoch in the last tenth of {study.recipe.epochs}, by share of the trainings: {shares}. These may not "
        "have converged, so better may only mean faster, and worse only slower.",
    )
