"""The variants of a study against its baseline: test, size, equivalence, and a verdict in a word.

Each variant is compared with the baseline by the study's primary metric on the test split. The p-values of all
variants are one family for Holm's correction, those for a difference and those for equivalence each.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from analysis.cautions import Caution, cautions
from analysis.effects import Effects, a12, effects
from analysis.equivalence import Equivalence, Margin, MarginKind, equivalence
from analysis.power import Detectable, detectable
from analysis.results import LOWER_IS_BETTER, Study
from analysis.samples import Sample, rounded
from analysis.statistics import MannWhitney, holm, mann_whitney, smallest_p
from analysis.study_checks import check_study
from tacevo.errors import RunError
from tacevo.randomness import stream

ALPHA = 0.05

#: What is no difference worth having, by metric: a tenth of the baseline's error, or one point of accuracy.
MARGINS = {
    "mse": Margin(value=0.1, kind=MarginKind.relative),
    "accuracy": Margin(value=0.01, kind=MarginKind.absolute),
}


class Verdict(StrEnum):
    """What a comparison says of a variant."""

    #: A difference was shown, in the variant's favour.
    better = "better"
    #: A difference was shown, in the baseline's favour.
    worse = "worse"
    #: No difference was shown, and one as large as the margin was ruled out: it matches the baseline.
    equivalent = "equivalent"
    #: Neither was shown; more seeds may tell.
    undecided = "undecided"


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """A variant against the baseline."""

    network: str
    median: float
    test: MannWhitney
    #: Of the test, after Holm's correction over all variants.
    p_holm: float
    effects: Effects
    equivalence: Equivalence
    #: Of the equivalence, after Holm's correction over all variants.
    equivalence_p_holm: float
    verdict: Verdict
    cautions: tuple[Caution, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparisons:
    """All variants of a study against its baseline."""

    metric: str
    #: Of each network.
    seeds: int
    alpha: float
    margin: Margin
    baseline_median: float
    #: The smallest effect that one test at alpha detects with a power of 80 %; None where it detects none so often.
    detectable: Detectable | None
    #: The same for the strictest step of Holm's correction, at alpha divided by the number of variants.
    detectable_holm: Detectable | None
    #: In the order of the study.
    variants: tuple[Comparison, ...]


def compare(study: Study, *, alpha: float = ALPHA, margin: Margin | None = None, seed: int = 0) -> Comparisons:
    """Compare every variant of a study with its baseline.

    Args:
        study: finished.
        alpha: level of the tests, in (0, 1); each family of p-values keeps it as a whole.
        margin: of equivalence; None takes the metric's own from `MARGINS`.
        seed: of the bootstrap. Each network has a stream of its own, so another variant changes no interval.

    Raises:
        RunError: scores are missing, there twice or not finite, there is no variant, or so few seeds that no
            outcome at all could be significant; the message names the rows.
        ValueError: alpha is not in (0, 1).
    """
    metric = study.primary
    check_study(study, metrics=(metric,))
    _check_seeds(study, alpha)
    baseline, *samples = (study.values(network.name, metric) for network in study.networks)
    margin = MARGINS[metric] if margin is None else margin
    return Comparisons(
        metric=metric,
        seeds=study.seeds,
        alpha=alpha,
        margin=margin,
        baseline_median=rounded(float(np.median(baseline))),
        detectable=detectable(study.seeds, alpha=alpha),
        detectable_holm=detectable(study.seeds, alpha=alpha / len(samples)),
        variants=_compared(study, baseline, samples, alpha=alpha, margin=_width(margin, baseline, metric), seed=seed),
    )


def _compared(
    study: Study, baseline: Sample, samples: Sequence[Sample], *, alpha: float, margin: float, seed: int
) -> tuple[Comparison, ...]:
    """Compare each variant's sample, and correct the p-values of both families."""
    metric = study.primary
    tests = [mann_whitney(sample, baseline) for sample in samples]
    equivalences = [equivalence(sample, baseline, margin=margin) for sample in samples]
    differ, equal = holm([test.p for test in tests]), holm([found.p for found in equivalences])
    return tuple(
        Comparison(
            network=network.name,
            median=rounded(float(np.median(sample))),
            test=tests[at],
            p_holm=differ[at],
            effects=effects(sample, baseline, rng=stream(seed, "bootstrap", network.name, metric)),
            equivalence=equivalences[at],
            equivalence_p_holm=equal[at],
            verdict=_verdict(a12(sample, baseline), metric, differs=differ[at] <= alpha, equals=equal[at] <= alpha),
            cautions=cautions(sample, baseline, alpha=alpha / len(samples)),
        )
        for at, (network, sample) in enumerate(zip(study.networks[1:], samples, strict=True))
    )


def _verdict(dominance: float, metric: str, *, differs: bool, equals: bool) -> Verdict:
    """Give the word for a variant whose values lie above the baseline's with this probability."""
    if differs:
        return Verdict.better if (dominance < 0.5) == LOWER_IS_BETTER[metric] else Verdict.worse
    return Verdict.equivalent if equals else Verdict.undecided


def _check_seeds(study: Study, alpha: float) -> None:
    """Refuse a study whose result is certain before it is made."""
    if not 0 < alpha < 1:
        raise ValueError(f"alpha must be in (0, 1); got {alpha}")
    if smallest_p(study.seeds, study.seeds) > alpha:
        needed = next(seeds for seeds in itertools.count(1) if smallest_p(seeds, seeds) <= alpha)
        raise RunError(
            f"a comparison at alpha {alpha} needs at least {needed} training seeds of each network, below which no "
            f"difference is significant; the study of {study.task} has {study.seeds}. Study it with more seeds"
        )


def _width(margin: Margin, baseline: Sample, metric: str) -> float:
    """Give the margin in the unit of the metric."""
    width = margin.around(float(np.median(baseline)))
    if width == 0:
        raise RunError(
            f"the baseline's median {metric} is 0, so a margin relative to it is no margin; state an absolute one"
        )
    return width
