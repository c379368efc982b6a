"""The tables of a study's test images: ensembles, and the variants on each output."""

from statistics import fmean

import pandas as pd

from analysis.statistics.effects import LEVEL
from analysis.statistics.image_statistics import IMAGE_RESAMPLES
from analysis.studies.image_findings import ImageFindings
from analysis.studies.metric_names import SHARES, metric_name, recorded_scale, recorded_unit
from analysis.table import Percent, PValue, Table
from analysis.tables.comparison import scaled, score_cell, unit_of
from tacevo.records import Kind
from tacevo.results.study import RecordedStudy
from tacevo.results.study_lines import fewest_seeds
from tacevo.results.trivial import trivial_score
from tacevo.rounding import rounded
from tacevo.rules import KEPT_SINCE
from tacevo.text import counted

_DIFFERENCE = (
    f"Difference: of the means of the seeds, in brackets its {100 * LEVEL:g} % interval by the percentiles of "
    f"{IMAGE_RESAMPLES:,} bootstrap resamples of test images and seeds together: where it holds 0, other images and "
    "other seeds may turn it."
)


def image_tables(study: RecordedStudy, findings: ImageFindings | None) -> tuple[Table, ...]:
    """Return the tables of a study's test images; without its test predictions, one that says so."""
    if findings is None:
        return (_without(study),)
    ensembles, outputs = findings
    return (ensembles_table(study, ensembles), *([image_outputs_table(study, outputs)] if len(outputs) else []))


def ensembles_table(study: RecordedStudy, ensembles: pd.DataFrame) -> Table:
    """Show each network as the mean of its seeds' predictions, and its difference from the baseline over images."""
    metric, name = study.primary, metric_name(study.primary)
    means = [rounded(fmean(study.values(network, metric))) for network in ensembles.network]
    mean, score = ((Percent, column) if metric in SHARES else column for column in ("mean", "score"))
    unit = unit_of(metric) if metric in SHARES else f"{name}, scaled"
    what = "probabilities of the classes" if study.kind is Kind.classification else "predictions"
    return Table.of(
        ensembles.assign(mean=means),
        {"network": "network", "mean of the seeds": mean, "ensemble": score}
        | {f"difference from the baseline ({unit})": scaled("difference", 100 if metric in SHARES else 1)},
        name="ensembles",
        caption=f"The networks of {study.task} as ensembles of their {study.seeds} seeds, test {name}.",
        notes=(
            f"Ensemble: the mean of the seeds' {what}. Trivial: looks at no image.",
            *((_DIFFERENCE,) if len(ensembles) > 1 else ()),
        ),
        last=(("trivial", score_cell(metric, trivial_score(study)), None, None),),
    )


def image_outputs_table(study: RecordedStudy, outputs: pd.DataFrame) -> Table:
    """Show every variant against the baseline on each output, image by image."""
    scale = recorded_scale(study)
    ends = ["difference", "difference_low", "difference_high"]
    squares = outputs.output.map(scale) ** 2
    return Table.of(
        outputs.assign(**outputs[ends].mul(squares, axis=0)),
        {
            **{"output": "output", "network": "network"},
            f"difference (MSE, {recorded_unit(study)})": scaled("difference", 1),
            **{"better on": "better", "worse on": "worse", "p": (PValue, "p"), "p, Holm": (PValue, "p_holm")},
            "verdict": "verdict",
        },
        name="image_outputs",
        caption=f"The variants of {study.task} against the baseline on each output, image by image.",
        notes=(
            "Difference: as in the table of ensembles, over images and seeds.",
            "Better on: images on which the network's squared error is the smaller. p: Wilcoxon's signed-rank test, "
            "two-sided.",
            "It asks whether these two ensembles differ on other images of the kind; not whether other seeds would.",
            _verdict_note(study),
            f"Corrected after Holm over all {counted(len(outputs), 'pair')} of output and variant, at alpha "
            f"{study.terms.alpha:g}.",
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
        name="ensembles",
        caption=f"The networks of {study.task} as ensembles of their {study.seeds} seeds.",
        columns=("network", "ensemble"),
        rows=tuple((network.name, "not kept" if is_old else "not found") for network in study.networks),
        notes=(f"Test predictions: {why}.",),
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
