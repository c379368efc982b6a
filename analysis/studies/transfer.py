"""The same networks, studied alike on several data sets: another split, sensor or light, or recordings."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd

from analysis.statistics.noise import agreement
from analysis.studies.comparison import Verdict, of_whole
from tacevo.records import to_json
from tacevo.results.study import LOWER_IS_BETTER, RecordedStudy
from tacevo.results.study_lines import Design
from tacevo.rounding import rounded
from tacevo.storage.canonical import content_hash

#: What the run's own data are called beside other data.
OWN = "the run's"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What became of one network on one data set."""

    median: float
    #: By the median, 1 is best; equal medians share the lower number. None of what is not a network.
    rank: int | None
    #: Corrected over the variants of this data set; None of the baseline, and where nothing could be compared.
    p_holm: float | None
    verdict: Verdict | None


@dataclass(frozen=True, slots=True, kw_only=True)
class OnData:
    """All networks on one data set."""

    #: How the data differ from the run's, or `OWN`.
    where: str
    study: RecordedStudy
    #: By the networks' names, in their order.
    results: Mapping[str, Result]
    #: Kendall's tau-b of its medians with those of the first data set; None of the first, and without two that differ.
    agreement: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Transfer:
    """Studies that differ in their data only."""

    #: Two at least, that of the run's data first.
    data: tuple[OnData, ...]

    def has(self, study: RecordedStudy) -> bool:
        """Return whether a study is one of them, or like one of them but for its plan."""
        return _shared(study) == _shared(self.data[0].study)


def transfers(studies: Iterable[tuple[RecordedStudy, pd.DataFrame | None]]) -> tuple[Transfer, ...]:
    """Find the studies of a run that differ in their data only, with the comparison of each where it has one."""
    groups: dict[str, dict[str, tuple[RecordedStudy, pd.DataFrame | None]]] = {}
    for study, found in studies:
        groups.setdefault(_shared(study), {}).setdefault(study.fingerprint, (study, found))
    return tuple(_transfer(list(group.values())) for group in groups.values() if len(group) > 1)


def _shared(study: RecordedStudy) -> str:
    """Name what a study has in common with itself on other data; a plan is of one of them, and changes no score."""
    kept = {field.name for field in fields(Design)} - {"data", "other_data", "plan"}
    return content_hash({name: to_json(getattr(study, name)) for name in kept})


def _transfer(group: list[tuple[RecordedStudy, pd.DataFrame | None]]) -> Transfer:
    ordered = sorted(group, key=lambda pair: (bool(pair[0].other_data), pair[0].where))
    first = _medians(ordered[0][0])
    return Transfer(
        data=tuple(
            OnData(
                where=study.where or OWN,
                study=study,
                results=_results(study, found),
                agreement=agreement(list(first.values()), list(_medians(study).values())) if number else None,
            )
            for number, (study, found) in enumerate(ordered)
        ),
    )


def _results(study: RecordedStudy, found: pd.DataFrame | None) -> dict[str, Result]:
    medians = _medians(study)
    sign = 1 if LOWER_IS_BETTER[study.primary] else -1
    compared = {one.network: one for one in of_whole(found).itertuples()}
    return {
        name: Result(
            median=median,
            rank=1 + sum(sign * other < sign * median for other in medians.values()),
            p_holm=compared[name].p_holm if name in compared else None,
            verdict=Verdict(compared[name].verdict) if name in compared else None,
        )
        for name, median in medians.items()
    }


def _medians(study: RecordedStudy) -> dict[str, float]:
    return {
        network.name: rounded(float(np.median(study.values(network.name, study.primary)))) for network in study.networks
    }
