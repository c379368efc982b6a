"""The tables of a study's test images: ensembles, and the variants on each output."""

from collections.abc import Sequence
from statistics import fmean
from typing import TYPE_CHECKING

import pandas as pd

from analysis.statistics.effects import LEVEL
from analysis.statistics.image_statistics import IMAGE_RESAMPLES
from analysis.studies.image_findings import ImageFindings, image_findings, load_predictions
from analysis.studies.metric_names import SHARES, metric_name, recorded_scale, recorded_unit
from analysis.studies.warnings import group_power_note
from analysis.table import Percent, PValue, Table
from analysis.tables.comparison import scaled, score_cell, unit_of
from tacevo.errors import CacheMissError, StoreError
from tacevo.parts.output import Output
from tacevo.records import Kind
from tacevo.results.grouped import images_tested
from tacevo.results.run import RecordedRun
from tacevo.results.study import RecordedStudy
from tacevo.results.study_lines import fewest_groups, fewest_seeds
from tacevo.results.trivial import trivial_score
from tacevo.rounding import rounded
from tacevo.rules import KEPT_SINCE
from tacevo.text import counted

if TYPE_CHECKING:
    from analysis.report.collection import Collection, Compared

#: Of a study of an earlier release.
UNRECORDED = (
    "The test images come in groups, such as the frames of a press, which this study does not record, being of an "
    "earlier release. Each image is counted as if it were recorded alone, so p is too small and intervals are too "
    "narrow. Study the run again with this release, which trains once more and records the groups."
)


class ImageTests(Output):
    """Adds what the test images of a study say: ensembles, and the variants on each output."""

    def findings(self, run: RecordedRun, study: "Compared") -> tuple[ImageFindings | None, list[str]]:
        """Compare a study's networks on its test images; where it keeps them and they cannot be read, say why."""
        try:
            predictions = load_predictions(study.study, run.stores)
        except (CacheMissError, StoreError) as error:
            reason = error if run.has_predictions else "the bundle of a sweep holds no test predictions"
            return None, [f"no tables of the test images of {run.path / 'studies' / study.name}: {reason}"]
        return None if predictions is None else image_findings(study.study, predictions), []

    def study_tables(self, run: "Collection", study: "Compared") -> Sequence[Table]:
        """Make the tables; without test predictions, one that says so."""
        return image_tables(study.study, study.found.get("images"))


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
            *((_difference_note(study), *_group_notes(study)) if len(ensembles) > 1 else ()),
        ),
        last=(("trivial", score_cell(metric, trivial_score(study)), None, None),),
    )


def image_outputs_table(study: RecordedStudy, outputs: pd.DataFrame) -> Table:
    """Show every variant against the baseline on each output, by images or by the groups that share a recording."""
    scale, one, several = recorded_scale(study), *_units(study)
    alpha, what = study.terms.alpha, "mean squared error" if study.data.is_grouped else "squared error"
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
        caption=f"The variants of {study.task} against the baseline on each output, {one} by {one}.",
        notes=(
            f"Difference: as in the table of ensembles, over {several} and seeds.",
            f"Better on: {several} on which the network's {what} is the smaller. p: Wilcoxon's signed-rank test, "
            "two-sided.",
            f"It asks whether these two ensembles differ on other {several} of the kind; not whether other seeds "
            "would.",
            _verdict_note(study),
            f"Corrected after Holm over all {counted(len(outputs), 'pair')} of output and variant, at alpha {alpha:g}.",
            *_group_notes(study, len(outputs)),
            *([group_power_note(study.data.units, alpha=alpha, family=len(outputs))] if study.data.is_grouped else []),
        ),
    )


def _units(study: RecordedStudy) -> tuple[str, str]:
    """Name what counts once, one and several: a test image, or all that were recorded together."""
    return ("group", "groups") if study.data.is_grouped else ("image", "images")


def _difference_note(study: RecordedStudy) -> str:
    drawn = "groups of test images" if study.data.is_grouped else "test images"
    return (
        f"Difference: of the means of the seeds, in brackets its {100 * LEVEL:g} % interval by the percentiles of "
        f"{IMAGE_RESAMPLES:,} bootstrap resamples of {drawn} and seeds together: where it holds 0, other "
        f"{_units(study)[1]} and other seeds may turn it."
    )


def _group_notes(study: RecordedStudy, tests: int = 1) -> tuple[str, ...]:
    """Say of how many groups the test images are, or that they are not recorded; and whether they suffice for tests."""
    if study.lacks_groups:
        return (UNRECORDED,)
    if not study.data.is_grouped:
        return ()
    told = f"{images_tested(study.data)}: those of a group were recorded together, so it counts once."
    if study.data.units >= (needed := fewest_groups(study.terms.alpha / tests)):
        return (told,)
    return (
        f"{told} They are too few: intervals over them are too narrow, and no test of fewer than {needed} groups is "
        "significant after Holm's correction.",
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
        f"Better and worse: p after Holm is at most {alpha:g}, and the interval of the difference, over "
        f"{_units(study)[1]} and seeds, does not hold 0. Undecided: all others."
    )
