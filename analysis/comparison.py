"""The variants of a study against its baseline: test, size, equivalence, and a verdict in a word.

Each variant is compared with the baseline by the study's primary metric on the test split. The p-values of all
variants are one family for Holm's correction, those for a difference and those for equivalence each.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from analysis.cautions import Caution, cautions
from analysis.effects import Effects, a12, effects
from analysis.equivalence import Equivalence, equivalence
from analysis.power import Detectable, detectable
from analysis.results import LOWER_IS_BETTER, Study
from analysis.samples import Sample
from analysis.statistics import MannWhitney, holm, mann_whitney, smallest_p
from tacevo.digits import rounded
from tacevo.errors import RunError
from tacevo.randomness import stream
from tacevo.terms import Margin, Terms, fewest_seeds


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
    terms: Terms
    baseline_median: float
    #: The smallest effect that one test at alpha detects with a power of 80 %; None where it detects none so often.
    detectable: Detectable | None
    #: The same for the strictest step of Holm's correction, at alpha divided by the number of variants.
    detectable_holm: Detectable | None
    #: In the order of the study.
    variants: tuple[Comparison, ...]


def compare(study: Study, *, seed: int = 0) -> Comparisons:
    """Compare every variant of a study with its baseline, on the study's own terms.

    Args:
        study: whole, as `analysis.studies.load_study` gives it.
        seed: of the bootstrap. Each network has a stream of its own, so another variant changes no interval.

    Raises:
        RunError: there is no variant, the margin is none, or there are so few seeds that no outcome at all could be
            significant.
    """
    metric, alpha = study.primary, study.terms.alpha
    _check_size(study)
    baseline, *samples = (study.values(network.name, metric) for network in study.networks)
    margin = _width(study.terms.margin, baseline, metric)
    return Comparisons(
        metric=metric,
        seeds=study.seeds,
        terms=study.terms,
        baseline_median=rounded(float(np.median(baseline))),
        detectable=detectable(study.seeds, alpha=alpha),
        detectable_holm=detectable(study.seeds, alpha=alpha / len(samples)),
        variants=_compared(study, baseline, samples, margin=margin, seed=seed),
    )


def _compared(
    study: Study, baseline: Sample, samples: Sequence[Sample], *, margin: float, seed: int
) -> tuple[Comparison, ...]:
    """Compare each variant's sample, and correct the p-values of both families."""
    metric, alpha = study.primary, study.terms.alpha
    tests = [mann_whitney(sample, baseline) for sample in samples]
    equivalences = [equivalence(sample, baseline, margin=margin) for sample in samples]
    differ, equal = holm([test.p for test in tests]), holm([found.p for found in equivalences])
    least = holm([smallest_p(len(sample), len(baseline)) for sample in samples])
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
            cautions=cautions(sample, baseline, least_p=least[at], alpha=alpha),
        )
        for at, (network, sample) in enumerate(zip(study.networks[1:], samples, strict=True))
    )


def _verdict(dominance: float, metric: str, *, differs: bool, equals: bool) -> Verdict:
    """Give the word for a variant whose values lie above the baseline's with this probability."""
    if differs:
        return Verdict.better if (dominance < 0.5) == LOWER_IS_BETTER[metric] else Verdict.worse
    return Verdict.equivalent if equals else Verdict.undecided


def _check_size(study: Study) -> None:
    """Refuse a study whose result is certain before it is made."""
    alpha = study.terms.alpha
    if len(study.networks) < 2:
        raise RunError(f"a comparison needs a variant beside the baseline; the study of {study.task} has none")
    needed = fewest_seeds(alpha)
    if study.seeds < needed:
        raise RunError(
            f"a comparison at alpha {alpha} needs at least {needed} training seeds of each network, below which no "
            f"difference is significant; the study of {study.task} has {study.seeds}. Study it with more seeds"
        )


def _width(margin: Margin, baseline: Sample, metric: str) -> float:
    """Give the margin in the unit of the metric."""
    width = margin.around(float(np.median(baseline)))
    if width == 0:
        raise RunError(
            f"the baseline's median {metric} is 0, so a margin relative to it is no margin; state an absolute one "
            "by the `tacevo study` settings margins.KIND.kind=absolute and margins.KIND.value"
        )
    return width
