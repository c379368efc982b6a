"""The variants of a study against its baseline: test, size, equivalence, and a verdict in a word.

Each variant is compared with the baseline by the study's primary metric on the test split. The p-values of all
variants are one family for Holm's correction, those for a difference and those for equivalence each. Where the primary
metric is a mean over several outputs, each variant is compared on each output, too; all of these are one more family.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from analysis.statistics.effects import Effects, Interval, effects
from analysis.statistics.equivalence import Equivalence, equivalence
from analysis.statistics.samples import Sample
from analysis.statistics.tests import MannWhitney, holm, mann_whitney, smallest_p
from analysis.studies.scores import LOWER_IS_BETTER, Study
from analysis.studies.warnings import Caution, cautions, late_share
from tacevo.config.study import Margin
from tacevo.errors import RunError
from tacevo.randomness import stream
from tacevo.rounding import rounded
from tacevo.studies.terms import Terms, fewest_seeds


class Verdict(StrEnum):
    """What a comparison says of a variant."""

    #: A difference was shown, in the variant's favour.
    better = "better"
    #: A difference was shown, in the baseline's favour.
    worse = "worse"
    #: No difference was shown, and one as large as the margin was ruled out: it matches the baseline.
    equivalent = "equivalent"
    #: Neither was shown; more seeds may show one.
    undecided = "undecided"


@dataclass(frozen=True, slots=True, kw_only=True)
class VariantComparison:
    """A variant against the baseline in one metric."""

    network: str
    median: float
    test: MannWhitney
    #: Of the test, after Holm's correction over its family.
    p_holm: float
    effects: Effects
    equivalence: Equivalence
    #: Of the equivalence, after Holm's correction over its family.
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
    #: In the order of the study; one family.
    variants: tuple[VariantComparison, ...]
    #: The same on each output of a regression of several, by its name; one family over variants and outputs. An output
    #: on which the baseline's median is 0 has no relative margin, and is left out.
    outputs: Mapping[str, tuple[VariantComparison, ...]]
    #: Of each network, the baseline too: part of its trainings whose best epoch lies in the last tenth, in [0, 1].
    late: Mapping[str, float]
    #: What one test image adds to an accuracy, in (0, 1]; None of a regression.
    image: float | None


def compare(study: Study, *, seed: int = 0) -> Comparisons:
    """Compare every variant of a study with its baseline, on the study's own terms.

    The seed is that of the bootstrap. Each network has a stream of its own, so another variant changes no interval.

    Raises:
        RunError: the study has no variant, the margin is 0, or there are so few seeds that no outcome at all could be
            significant.
    """
    metric = study.primary
    _check_size(study)
    baseline = study.networks[0]
    outputs = _outputs(study)
    return Comparisons(
        metric=metric,
        seeds=study.seeds,
        terms=study.terms,
        baseline_median=rounded(float(np.median(study.values(baseline.name, metric)))),
        variants=_compared(study, [metric], seed)[0],
        outputs=dict(zip(outputs, _compared(study, [f"{metric}_{name}" for name in outputs], seed), strict=True)),
        late={network.name: _late(study, network.name) for network in study.networks},
        image=_image(study),
    )


def _outputs(study: Study) -> list[str]:
    """Name the outputs that variants can be compared on, where the primary metric is a mean over several."""
    measured, margin, baseline = study.scores[0].metrics, study.terms.margin, study.networks[0].name
    metrics = {name: f"{study.primary}_{name}" for name in study.names}
    if len(metrics) < 2 or not measured.keys() >= set(metrics.values()):
        return []
    return [name for name, metric in metrics.items() if margin.around(float(np.median(study.values(baseline, metric))))]


def _late(study: Study, network: str) -> float:
    chosen = [score.epoch for score in study.scores if score.network == network]
    return rounded(late_share(chosen, epochs=study.recipe.epochs))


def _image(study: Study) -> float | None:
    confusion = study.scores[0].confusion
    return None if confusion is None else rounded(1 / sum(map(sum, confusion)))


def _compared(study: Study, metrics: Sequence[str], seed: int) -> list[tuple[VariantComparison, ...]]:
    """Compare every variant by each metric, and correct all p-values as one family of each kind.

    Returns:
        For each metric, its variants in the order of the study.
    """
    if not metrics:
        return []
    alpha, lower = study.terms.alpha, LOWER_IS_BETTER[study.primary]
    pairs = [(metric, network.name) for metric in metrics for network in study.networks[1:]]
    samples = [(study.values(name, metric), study.values(study.networks[0].name, metric)) for metric, name in pairs]
    tests = [mann_whitney(*sample) for sample in samples]
    equivalences = [
        equivalence(*sample, margin=_width(study.terms.margin, sample[1], metric))
        for (metric, _), sample in zip(pairs, samples, strict=True)
    ]
    differ, equal = holm([test.p for test in tests]), holm([found.p for found in equivalences])
    sizes = [
        effects(*sample, rng=stream(seed, "bootstrap", name, metric))
        for (metric, name), sample in zip(pairs, samples, strict=True)
    ]
    least = holm([smallest_p(study.seeds, study.seeds)] * len(pairs))
    found = [
        VariantComparison(
            network=name,
            median=rounded(float(np.median(samples[at][0]))),
            test=tests[at],
            p_holm=differ[at],
            effects=sizes[at],
            equivalence=equivalences[at],
            equivalence_p_holm=equal[at],
            verdict=_verdict(sizes[at].a12, lower=lower, differs=differ[at] <= alpha, equals=equal[at] <= alpha),
            cautions=cautions(*samples[at], least_p=least[at], alpha=alpha),
        )
        for at, (metric, name) in enumerate(pairs)
    ]
    variants = len(study.networks) - 1
    return [tuple(found[first : first + variants]) for first in range(0, len(found), variants)]


def _verdict(a12: Interval, *, lower: bool, differs: bool, equals: bool) -> Verdict:
    """Return the word for a variant whose values lie above the baseline's with this probability.

    Where values tie, the test can be significant while the interval holds a half; then no difference was shown.
    """
    if differs and not a12.low <= 0.5 <= a12.high:
        return Verdict.better if (a12.estimate < 0.5) == lower else Verdict.worse
    return Verdict.equivalent if equals else Verdict.undecided


def _check_size(study: Study) -> None:
    """Check that some outcome of a comparison could be significant."""
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


def _width(margin: Margin, baseline: Sample, metric: str) -> float:
    """Return the margin in the unit of the metric."""
    width = margin.around(float(np.median(baseline)))
    if width == 0:
        raise RunError(
            "0",
            place=f"the baseline's median {metric}",
            expected="a value above 0, of which a relative margin is a part",
            remedy="study it again with an absolute margin: margins.KIND.kind=absolute and margins.KIND.value",
        )
    return width
