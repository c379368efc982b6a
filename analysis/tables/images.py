"""The tables of a study's test images: ensembles, pairs of networks, outputs, calibration or residuals."""

from statistics import fmean

from analysis.statistics.calibration import BINS, Calibration
from analysis.statistics.effects import LEVEL
from analysis.statistics.images import IMAGE_RESAMPLES
from analysis.studies.images import Calibrated, ImageFindings, Pair, Residuals
from analysis.studies.metrics import SHARES, metric_name, recorded_scale, recorded_unit
from analysis.table import Cell, PValue, Table
from analysis.tables.comparison import between, quartiles, score_cell
from tacevo.records import Kind
from tacevo.results.study import LOWER_IS_BETTER, RecordedStudy
from tacevo.results.study_terms import fewest_seeds
from tacevo.results.trivial import trivial_score
from tacevo.rounding import rounded
from tacevo.rules import KEPT_SINCE
from tacevo.text import counted

_DIFFERENCE = (
    f"Difference: of the means of the seeds, in brackets its {100 * LEVEL:g} % interval by the percentiles of "
    f"{IMAGE_RESAMPLES:,} bootstrap resamples of test images and seeds together: where it holds 0, other images and "
    "other seeds may turn it."
)

#: The columns of a test of two ensembles, and the word for it.
_TESTED = ("better on", "worse on", "p", "p, Holm", "verdict")


def image_tables(study: RecordedStudy, found: ImageFindings | None) -> tuple[Table, ...]:
    """Return the tables of a study's test images; without its test predictions, one that says so."""
    if found is None:
        return (_without(study),)
    last = calibration_table if study.kind is Kind.classification else residuals_table
    outputs = (image_outputs_table(study, found),) if found.outputs else ()
    pairs = (pairs_table(study, found),)
    return ensembles_table(study, found), *pairs, *outputs, last(study, found)


def ensembles_table(study: RecordedStudy, found: ImageFindings) -> Table:
    """Show each network as the mean of its seeds' predictions, and its difference from the baseline over images."""
    metric, name = study.primary, metric_name(study.primary)
    score = trivial_score(study)
    return Table(
        name=f"ensembles_{study.task}",
        caption=f"The networks of {study.task} as ensembles of their {study.seeds} seeds, test {name}.",
        columns=("network", "mean of the seeds", "ensemble", f"difference from the baseline ({_unit(metric)})"),
        rows=(
            *(
                (
                    one.network,
                    score_cell(metric, rounded(fmean(study.values(one.network, metric)))),
                    score_cell(metric, one.score),
                    between(one.difference, _factor(metric)),
                )
                for one in found.ensembles
            ),
            ("trivial", score_cell(metric, score), None, None),
        ),
        notes=(
            f"Ensemble: the mean of the seeds' {_what(study)}. Trivial: looks at no image.",
            *((_DIFFERENCE,) if found.pairs else ()),
        ),
    )


def pairs_table(study: RecordedStudy, found: ImageFindings) -> Table:
    """Show every two ensembles on the same images, and each beside the trivial predictor."""
    of_networks = f"over all {counted(len(found.pairs), 'pair')} of networks, and " if found.pairs else ""
    return Table(
        name=f"pairs_{study.task}",
        caption=f"The ensembles of {study.task} by pairs, on the same {study.data.counts[2]} test images.",
        columns=("network", "against", f"difference ({_unit(study.primary)})", *_TESTED),
        rows=tuple(
            (pair.first, pair.second, between(pair.difference, _factor(study.primary)), *_tested(pair))
            for pair in (*found.pairs, *found.against_trivial)
        ),
        notes=(
            *_test_notes(study),
            _DIFFERENCE,
            f"Corrected after Holm at alpha {study.terms.alpha:g}, {of_networks}over those with the trivial predictor, "
            f"a family of their own: it looks at no image, and always predicts their {_always(study)}.",
        ),
    )


def image_outputs_table(study: RecordedStudy, found: ImageFindings) -> Table:
    """Show every variant against the baseline on each output, image by image."""
    scale = recorded_scale(study)
    return Table(
        name=f"image_outputs_{study.task}",
        caption=f"The variants of {study.task} against the baseline on each output, image by image.",
        columns=("output", "network", f"difference (MSE, {recorded_unit(study, '²')})", *_TESTED),
        rows=tuple(
            (output, pair.first, between(pair.difference, scale[output] ** 2), *_tested(pair))
            for output, pair in found.outputs
        ),
        notes=(
            "Difference: as in the table of ensembles, over images and seeds.",
            *_test_notes(study),
            f"Corrected after Holm over all {counted(len(found.outputs), 'pair')} of output and variant, at alpha "
            f"{study.terms.alpha:g}.",
        ),
    )


def calibration_table(study: RecordedStudy, found: ImageFindings) -> Table:
    """Show how well each classifier knows how sure it may be."""
    trivial = () if found.trivial is None else (("trivial", *_calibrated(found.trivial)),)
    return Table(
        name=f"calibration_{study.task}",
        caption=f"Calibration of the networks of {study.task} on the test images; less is better.",
        columns=(
            *("network", "ECE", "ECE, ensemble", "Brier", "Brier, ensemble"),
            *("cross-entropy (nats)", "cross-entropy, ensemble (nats)"),
        ),
        rows=(*(_calibration_row(one) for one in found.calibrations), *trivial),
        notes=(
            "Median of the seeds, with their lower and upper quartile in brackets; ensemble: of the mean "
            "probabilities.",
            f"ECE: expected calibration error over {BINS} equal bins of confidence. With few images it is above 0 for "
            "a perfectly calibrated classifier, too. Brier: over all classes, from 0 to 2.",
            "Trivial: looks at no image, and gives each class its frequency among the test images.",
        ),
    )


def residuals_table(study: RecordedStudy, found: ImageFindings) -> Table:
    """Show what each network's predictions of each output are off by, in the units of the recording."""
    unit, scale = recorded_unit(study), recorded_scale(study)
    heads = ("bias", "spread", "bias, ensemble", "spread, ensemble")
    return Table(
        name=f"residuals_{study.task}",
        caption=f"What the predictions of {study.task} are off by on the test images, by output.",
        columns=("output", "network", *(f"{head} ({unit})" for head in heads)),
        rows=tuple(
            row
            for output in study.names
            for row in (
                *(_residual_row(one, scale[output]) for one in found.residuals if one.output == output),
                (output, "trivial", 0, rounded(scale[output] * found.spreads[output]), None, None),
            )
        ),
        notes=(
            "Bias: mean of prediction less label; spread: standard deviation of the same over the images. Median of "
            "the seeds, with their lower and upper quartile in brackets.",
            "Trivial: looks at no image, and always predicts the mean of the test images.",
        ),
    )


def _without(study: RecordedStudy) -> Table:
    is_old = not any(score.kept for score in study.scores)
    why = (
        f"not kept, since the study was made under rules {study.rules} and these are kept from {KEPT_SINCE} on; study "
        "the run again with this release"
        if is_old
        else "not found in the store"
    )
    return Table(
        name=f"ensembles_{study.task}",
        caption=f"The networks of {study.task} as ensembles of their {study.seeds} seeds.",
        columns=("network", "ensemble"),
        rows=tuple((network.name, "not kept" if is_old else "not found") for network in study.networks),
        notes=(f"Test predictions: {why}.",),
    )


def _always(study: RecordedStudy) -> str:
    return "most frequent class" if study.kind is Kind.classification else "mean"


def _what(study: RecordedStudy) -> str:
    return "probabilities of the classes" if study.kind is Kind.classification else "predictions"


def _factor(metric: str) -> int:
    return 100 if metric in SHARES else 1


def _unit(metric: str) -> str:
    return "percentage points" if metric in SHARES else f"{metric_name(metric)}, scaled"


def _tested(pair: Pair) -> tuple[Cell, ...]:
    return (
        pair.test.first,
        pair.test.second,
        PValue(pair.test.p),
        PValue(pair.p_holm),
        pair.verdict and pair.verdict.value,
    )


def _test_notes(study: RecordedStudy) -> tuple[str, ...]:
    if LOWER_IS_BETTER[study.primary]:
        test = "Better on: images on which the network's squared error is the smaller. p: Wilcoxon's signed-rank test"
    else:
        test = "Better on: images on which the network alone is right. p: McNemar's exact test"
    return (
        f"{test}, two-sided.",
        "It asks whether these two ensembles differ on other images of the kind; not whether other seeds would.",
        _verdict_note(study),
    )


def _verdict_note(study: RecordedStudy) -> str:
    """Say what a verdict rests on, or why there is none."""
    alpha, needed = study.terms.alpha, fewest_seeds(study.terms.alpha)
    if study.seeds < needed:
        return f"No verdicts: {counted(study.seeds, 'seed')}, and it takes {needed} at alpha {alpha:g}."
    return (
        f"Better and worse: p after Holm is at most {alpha:g}, and the interval of the difference, over images and "
        "seeds, does not hold 0. Undecided: all others."
    )


def _calibration_row(one: Calibrated) -> tuple[Cell, ...]:
    figures = ("ece", "brier", "cross_entropy")
    cells = [
        cell
        for figure in figures
        for cell in (quartiles([getattr(each, figure) for each in one.seeds]), getattr(one.ensemble, figure))
    ]
    return (one.network, *cells)


def _calibrated(one: Calibration) -> tuple[Cell, ...]:
    return one.ece, None, one.brier, None, one.cross_entropy, None


def _residual_row(one: Residuals, scale: float) -> tuple[Cell, ...]:
    seeds = (quartiles([scale * value for value in each]) for each in (one.biases, one.spreads))
    return (one.output, one.network, *seeds, rounded(scale * one.bias), rounded(scale * one.spread))
