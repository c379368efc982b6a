"""The same networks, studied alike on several data sets: another split, sensor or light, or recordings."""

from collections.abc import Iterable, Sequence
from dataclasses import fields

import numpy as np
import pandas as pd
from scipy.stats import friedmanchisquare

from tacevo.records import to_json
from tacevo.results.study import RecordedStudy
from tacevo.results.study_lines import Design
from tacevo.storage.canonical import content_hash

#: A study on some data, and what it says of the variants; None where it could not be compared.
OnData = tuple[RecordedStudy, pd.DataFrame | None]


def transfers(studies: Iterable[OnData]) -> tuple[tuple[OnData, ...], ...]:
    """Find the studies of a run that differ in their data only: one of each data set, that of the run's data first."""
    groups: dict[str, dict[str, OnData]] = {}
    for study, found in studies:
        groups.setdefault(_shared(study), {}).setdefault(study.fingerprint, (study, found))
    return tuple(
        tuple(sorted(group.values(), key=lambda pair: (bool(pair[0].other_data), pair[0].where)))
        for group in groups.values()
        if len(group) > 1
    )


def concordance(studies: Sequence[OnData]) -> float | None:
    """Measure how far several data sets agree on the order of the networks, by their medians: Kendall's W.

    It is Friedman's statistic divided by its largest value (Kendall and Babington Smith 1939), corrected for ties.

    Returns:
        From 0, no agreement, to 1, one order everywhere; None of fewer than three networks, or where all are equal.
    """
    first, _ = studies[0]
    medians = [
        [float(np.median(study.values(network.name, study.primary))) for study, _ in studies]
        for network in first.networks
    ]
    most = len(studies) * (len(medians) - 1)
    if len(medians) < 3 or all(len(set(column)) == 1 for column in zip(*medians, strict=True)):
        return None
    return float(friedmanchisquare(*medians).statistic) / most


def is_alone(study: RecordedStudy, others: Iterable[RecordedStudy]) -> bool:
    """Return whether no other study has its networks, alike, on other data."""
    return not any(_shared(one) == _shared(study) and one.fingerprint != study.fingerprint for one in others)


def _shared(study: RecordedStudy) -> str:
    """Name what a study has in common with itself on other data; a plan is of one of them, and changes no score."""
    kept = {field.name for field in fields(Design)} - {"data", "other_data", "plan"}
    return content_hash({name: to_json(getattr(study, name)) for name in kept})
