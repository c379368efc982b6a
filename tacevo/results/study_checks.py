"""Check that a study is whole: every network with every seed, once, and with the same metrics; else rows are named."""

from collections import Counter

from tacevo.errors import RunError
from tacevo.results.study import RecordedStudy
from tacevo.text import listed

BASELINE = "baseline"

#: Rows that a message names.
_MOST = 6


def check_study(study: RecordedStudy) -> None:
    """Check that statistics can be made of a study.

    Raises:
        RunError: the baseline is not the first network, or scores are missing, twice there, of an unknown network or
            seed, or of different metrics; the message names the rows.
    """
    place = f"the study of {study.task}"
    names = [network.name for network in study.networks]
    if names[:1] != [BASELINE] or len(set(names)) < len(names):
        raise RunError(listed(names), place=place, expected="the baseline, then variants of different names")
    wanted = [(name, seed) for name in names for seed in range(study.seeds)]
    known = Counter((score.network, score.seed) for score in study.scores)
    metrics = {metric for score in study.scores for metric in score.metrics}
    faults = {
        "missing": [row for row in wanted if row not in known],
        "twice": [row for row, times in known.items() if times > 1],
        "not of the study": sorted(known.keys() - set(wanted)),
        "without some metric": [(one.network, one.seed) for one in study.scores if one.metrics.keys() != metrics],
    }
    if any(faults.values()):
        told = (
            f"{words}: {listed((f'{name} with seed {seed}' for name, seed in rows), most=_MOST)}"
            for words, rows in faults.items()
            if rows
        )
        raise RunError(
            "; ".join(told),
            place=place,
            expected="one score for every network and seed",
            remedy="delete its directory; `tacevo study` writes it again from the store",
        )
