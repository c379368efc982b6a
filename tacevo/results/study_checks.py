"""Check that a study is whole: every network with every seed, once, and with numbers; else the rows are named."""

from collections import Counter
from collections.abc import Collection, Iterator

from analysis.statistics.samples import not_finite
from tacevo.errors import RunError
from tacevo.results.study import RecordedStudy
from tacevo.results.study_lines import Network
from tacevo.text import counted, listed

BASELINE = "baseline"


def check_study(study: RecordedStudy) -> None:
    """Check that statistics can be made of a study.

    Raises:
        RunError: the baseline is not the first network, or scores are missing, twice there, of an unknown network, not
            finite, or of different metrics; the message names the rows.
    """
    place = f"the study of {study.task}"
    names = [network.name for network in study.networks]
    if names[:1] != [BASELINE] or len(set(names)) < len(names):
        raise RunError(listed(names), place=place, expected="the baseline, then variants of different names")
    unknown = sorted({score.network for score in study.scores} - set(names))
    if unknown:
        raise RunError(f"scores of {listed(unknown)}", place=place, expected=f"only scores of {listed(names)}")
    metrics = {metric for score in study.scores for metric in score.metrics}
    faults = [fault for network in study.networks for fault in _faults(study, network, sorted(metrics))]
    if faults:
        raise RunError(
            f"{counted(len(faults), 'fault')}: {'; '.join(faults)}",
            place=place,
            expected="one finite score for every network and seed",
            remedy="delete its directory; `tacevo study` writes it again from the store",
        )


def _faults(study: RecordedStudy, network: Network, metrics: Collection[str]) -> Iterator[str]:
    """List the faults of a network's scores."""
    scores = sorted((score for score in study.scores if score.network == network.name), key=lambda score: score.seed)
    counts = Counter(score.seed for score in scores)
    expected = range(study.seeds)
    for words, seeds in (
        ("no score for", [seed for seed in expected if seed not in counts]),
        ("more than one score for", [seed for seed, times in counts.items() if times > 1]),
        (f"scores beyond the {study.seeds} seeds of the study, for", [seed for seed in counts if seed not in expected]),
    ):
        if seeds:
            yield f"{network.name} has {words} seeds {seeds}"
    for metric in metrics:
        without = [score.seed for score in scores if metric not in score.metrics]
        present = [score for score in scores if metric in score.metrics]
        broken = not_finite([score.metrics[metric] for score in present])
        if without:
            yield f"{network.name} has no {metric} for seeds {without}"
        if broken:
            yield f"{network.name} has a {metric} that is not finite for seeds {[present[at].seed for at in broken]}"
