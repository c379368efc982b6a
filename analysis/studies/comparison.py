"""The variants of a study against its baseline: test, size, equivalence, and a verdict in a word.

Each variant is compared with the baseline by the study's primary metric on the test split. The p-values of all
variants are one family for Holm's correction, those for a difference and those for equivalence each. Where the primary
metric is a mean over several outputs, each variant is compared on each output, too; all of these are one more family.
"""

from collections import Counter
from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from analysis.statistics.effects import EFFECTS, effects
from analysis.statistics.samples import Sample
from analysis.statistics.tests import equivalence, holm, mann_whitney, smallest_p
from analysis.studies.ceiling import is_at_ceiling
from analysis.studies.metric_names import SHARES
from analysis.studies.warnings import Caution, cautions
from tacevo.config.study import Margin
from tacevo.errors import RunError
from tacevo.randomness import stream
from tacevo.results.study import LOWER_IS_BETTER, RecordedStudy
from tacevo.results.study_lines import fewest_seeds, is_late
from tacevo.rounding import rounded


class Verdict(StrEnum):
    """The verdict of a comparison on a variant."""

    #: A difference was shown, in the variant's favour.
    better = "better"
    #: A difference was shown, in the baseline's favour.
    worse = "worse"
    #: No difference was shown, and one as large as the margin was ruled out: it matches the baseline.
    equivalent = "equivalent"
    #: Neither was shown; more seeds may show one.
    undecided = "undecided"


#: The columns of a study's comparisons, and the type of each: the output, missing where a row is of the primary metric
#: itself; the variant, and the median of its seeds; the margin of equivalence, in the metric's unit; the test, its p
#: before and after Holm's correction over the family; the effects; p of equivalence, likewise; verdict and cautions.
COMPARISONS = (
    {"output": "str", "network": "str", "median": "float64", "margin": "float64"}
    | {"u": "float64", "p": "float64", "p_holm": "float64", "method": "str"}
    | dict.fromkeys(EFFECTS, "float64")
    | {"p_equivalence": "float64", "p_equivalence_holm": "float64", "method_equivalence": "str"}
    | {"verdict": "str", "cautions": "object"}
)


def compare(study: RecordedStudy) -> pd.DataFrame:
    """Compare every variant of a study with its baseline, on the study's own terms.

    Each network has a stream of its own for the bootstrap, so another variant changes no interval.

    Returns:
        A row for each variant, in the order of the study, one family; then the same on each output of a regression of
        several, one family over variants and outputs (`COMPARISONS`). An output on which the baseline's median is 0 has
        no relative margin, and is left out.

    Raises:
        RunError: the study has no variant, the margin is 0, or there are so few seeds that no outcome at all could be
            significant.
    """
    _check_size(study)
    rows = _compared(study, {None: study.primary})
    if outputs := _outputs(study):
        rows += _compared(study, {name: f"{study.primary}_{name}" for name in outputs})
    return pd.DataFrame(rows, columns=list(COMPARISONS)).astype(COMPARISONS)


def of_whole(comparisons: pd.DataFrame | None) -> pd.DataFrame:
    """Return the rows of the primary metric itself; none without comparisons."""
    return pd.DataFrame(columns=list(COMPARISONS)) if comparisons is None else comparisons[comparisons.output.isna()]


def late(study: RecordedStudy) -> dict[str, float]:
    """Return, of each network, the part of its trainings whose best epoch lies in the last tenth, in [0, 1].

    Such a training may not have converged: against it, a network that is called better may only be faster.
    """
    late_ones = Counter(one.network for one in study.scores if is_late(one, study.recipe.epochs))
    return {network.name: rounded(late_ones[network.name] / study.seeds) for network in study.networks}


def deciding_p(comparison: Any) -> float:
    """Return the p, after Holm, of the test that gave a comparison its word: of equivalence, or of a difference.

    `comparison` is a row of `COMPARISONS`, by attribute.
    """
    is_equal = comparison.verdict == Verdict.equivalent
    return float(comparison.p_equivalence_holm if is_equal else comparison.p_holm)


def _outputs(study: RecordedStudy) -> list[str]:
    """Name the outputs that variants can be compared on, where the primary metric is a mean over several."""
    measured, margin, baseline = study.scores[0].metrics, study.terms.margin, study.networks[0].name
    metrics = {name: f"{study.primary}_{name}" for name in study.names}
    if len(metrics) < 2 or not measured.keys() >= set(metrics.values()):
        return []
    return [name for name, metric in metrics.items() if _around(margin, study.values(baseline, metric), metric)]


def _compared(study: RecordedStudy, metrics: Mapping[str | None, str]) -> list[dict[str, Any]]:
    """Compare every variant by each metric, and correct all p-values as one family of each kind."""
    rows: list[dict[str, Any]] = []
    alpha, family = study.terms.alpha, len(metrics) * (len(study.networks) - 1)
    least = holm([smallest_p(study.seeds, study.seeds)] * family)[-1]
    for output, metric in metrics.items():
        y = study.values(study.networks[0].name, metric)
        margin, usual = _width(study.terms.margin, y, metric), rounded(float(np.median(y)))
        of_baseline = (
            *([Caution.wide_margin] if study.primary in SHARES and margin >= rounded(1 - usual) else []),
            *([Caution.ceiling] if is_at_ceiling(study, usual, margin) else []),
        )
        for network in study.networks[1:]:
            x = study.values(network.name, metric)
            test, (p, method) = mann_whitney(x, y), equivalence(x, y, margin=margin)
            row: dict[str, Any] = {
                "output": output,
                "network": network.name,
                "median": rounded(float(np.median(x))),
                "margin": margin,
            }
            row |= {"u": test.u, "p": test.p, "method": test.method.value}
            row |= {"p_equivalence": p, "method_equivalence": method.value}
            row |= effects(x, y, rng=stream(0, "bootstrap", network.name, metric))
            told = cautions(x, y, method=test.method, least_p=least, alpha=alpha)
            rows.append(row | {"cautions": (*told, *of_baseline)})
    for name in ("p", "p_equivalence"):
        for row, p in zip(rows, holm([row[name] for row in rows]), strict=True):
            row[f"{name}_holm"] = p
    for row in rows:
        differs, equals = row["p_holm"] <= alpha, row["p_equivalence_holm"] <= alpha
        row["verdict"] = _verdict(row, lower=LOWER_IS_BETTER[study.primary], differs=differs, equals=equals).value
    return rows


def _verdict(row: Mapping[str, float], *, lower: bool, differs: bool, equals: bool) -> Verdict:
    """Return the word for a variant whose values lie above the baseline's with this probability.

    Where values tie, the test can be significant while the interval holds a half; then no difference was shown.
    """
    if differs and not row["a12_low"] <= 0.5 <= row["a12_high"]:
        return Verdict.better if (row["a12"] < 0.5) == lower else Verdict.worse
    return Verdict.equivalent if equals else Verdict.undecided


def _check_size(study: RecordedStudy) -> None:
    place = f"the study of {study.task}"
    if len(study.networks) < 2:
        raise RunError("the baseline alone", place=place, expected="a baseline and at least one variant")
    needed = fewest_seeds(study.terms.alpha)
    if study.seeds < needed:
        raise RunError(
            str(study.seeds),
            place=place,
            expected=f"at least {needed} training seeds, below which no difference is significant at alpha "
            f"{study.terms.alpha}",
            remedy="study it with more seeds",
        )


def _around(margin: Margin, baseline: Sample, metric: str) -> float:
    return margin.around(float(np.median(baseline)), is_share=metric in SHARES)


def _width(margin: Margin, baseline: Sample, metric: str) -> float:
    width = _around(margin, baseline, metric)
    if width == 0:
        raise RunError(
            "0",
            place=f"the baseline's median {metric}",
            expected="errors, of which such a margin is a part",
            remedy="study it again with an absolute margin: margins.KIND.kind=absolute and margins.KIND.value",
        )
    return width
