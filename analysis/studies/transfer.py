"""The same networks, studied alike on several data sets: another split, sensor or light, or recordings."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import friedmanchisquare

from analysis.statistics.tests import blocked_mann_whitney, holm, sign_p
from analysis.studies.comparison import Verdict
from tacevo.choices import ALL_SENSORS
from tacevo.config.schema import DataConfig
from tacevo.records import to_json
from tacevo.results.study import LOWER_IS_BETTER, RecordedStudy, shared_terms
from tacevo.rounding import rounded
from tacevo.storage.canonical import content_hash

#: A study on some data, and what it says of the variants; None where it could not be compared.
OnData = tuple[RecordedStudy, pd.DataFrame | None]


def transfers(studies: Iterable[OnData]) -> tuple[tuple[OnData, ...], ...]:
    """Find the studies of a run that differ in their data only: one of each data set, that of the run's data first.

    Studies that test another sensor than they train on stand apart, by how many sensors they join: those of each
    protocol have the same question, and those of several protocols share their test images.
    """
    groups: dict[tuple[str, bool, int], dict[str, OnData]] = {}
    for study, comparisons in studies:
        sensors = _setting(study, "sensor")
        joined = -1 if sensors == ALL_SENSORS else sensors.count("+")
        key = shared_terms(study), tested_sensor(study) is not None, joined
        groups.setdefault(key, {}).setdefault(study.fingerprint, (study, comparisons))
    return tuple(
        tuple(sorted(group.values(), key=lambda pair: (bool(pair[0].other_data), _by_numbers(pair[0].where))))
        for group in groups.values()
        if len(group) > 1
    )


def _by_numbers(text: str) -> list[str | int]:
    """Return what sorts texts by the numbers in them: 5 shots before 10."""
    return [int(part) if number % 2 else part for number, part in enumerate(re.split(r"(\d+)", text))]


def tested_sensor(study: RecordedStudy) -> str | None:
    """Return the sensor that a study tests and does not train on; None where there is none."""
    return _setting(study, "test_sensor") or None


def _setting(study: RecordedStudy, name: str) -> str:
    """Return a setting of other data as a text, empty where it has none."""
    return str(dict(study.other_data).get(name) or "")


#: The settings that say which sensors train and which one is tested.
_OF_SENSORS = ("sensor", "test_sensor", "shots")


@dataclass(frozen=True, slots=True, kw_only=True)
class OnSensors:
    """A study of a run, with the sensors that trained and the one that was tested, in words."""

    study: RecordedStudy
    trained: str
    tested: str


def sensor_groups(studies: Iterable[RecordedStudy], own: DataConfig) -> tuple[tuple[OnSensors, ...], ...]:
    """Find the studies of a run that differ in their sensors only, whatever the protocol: one of each pair.

    `own` are the settings of data of the run, which its studies have unless they say otherwise. A group has several
    pairs of what is trained on and what is tested, and one at least that differ: of sensors within themselves alone
    there is no matrix, and the table of transfer says all.
    """
    groups: dict[str, dict[tuple[str, str], OnSensors]] = {}
    for study in studies:
        settings = {name: getattr(own, name) for name in _OF_SENSORS} | dict(study.other_data)
        rest = {name: to_json(value) for name, value in study.other_data if name not in _OF_SENSORS}
        trained, tested = _in_words(str(settings["sensor"]), settings["test_sensor"], settings["shots"])
        key = content_hash([shared_terms(study), rest])
        groups.setdefault(key, {}).setdefault((trained, tested), OnSensors(study=study, trained=trained, tested=tested))
    return tuple(
        tuple(group.values())
        for group in groups.values()
        if len(group) > 1 and any(trained != tested for trained, tested in group)
    )


def _in_words(sensor: str, test_sensor: object, shots: object) -> tuple[str, str]:
    """Say which sensors train, in words that are equal where each of several is left out, and which one is tested."""
    if test_sensor is None:
        return sensor, sensor
    named = sensor.split("+")
    if test_sensor in named and len(named) == 2:
        trained = next(name for name in named if name != test_sensor)
    elif test_sensor in named or sensor == ALL_SENSORS:
        trained = "all others" if sensor == ALL_SENSORS else f"the others of {sensor}"
    else:
        trained = sensor
    return trained + (f", {shots} shots" if shots else ""), str(test_sensor)


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


#: The columns of a joint answer over data sets, and the type of each, a variant a row: on how many its median is better
#: than the baseline's, equal and worse; the part of the pairs of seeds, each of one data set, in which the variant is
#: better, ties half; p of the blocked test of the seeds and the word for these data sets; p of the sign test of the
#: data sets and the word for others drawn as they were. Both p are after Holm's correction over the variants.
JOINT = {"network": "str", "better": "int64", "equal": "int64", "worse": "int64", "ahead": "float64"}
JOINT |= {"p_here": "float64", "here": "str", "p_elsewhere": "float64", "elsewhere": "str"}


def joint(studies: Sequence[OnData]) -> pd.DataFrame:
    """Compare every variant with the baseline over the data sets of a transfer together (`JOINT`).

    Two questions differ: whether a network is better on these data sets, where seeds are the sample and data sets the
    blocks; and whether it would be on others, where each data set counts once. From two seeds on.
    """
    first, _ = studies[0]
    sign = -1 if LOWER_IS_BETTER[first.primary] else 1
    samples = {
        network.name: [sign * one.values(network.name, first.primary) for one, _ in studies]
        for network in first.networks
    }
    baseline, *variants = samples
    rows = []
    for name in variants:
        pairs = list(zip(samples[name], samples[baseline], strict=True))
        leads = [float(np.median(x)) - float(np.median(y)) for x, y in pairs]
        better, worse = sum(lead > 0 for lead in leads), sum(lead < 0 for lead in leads)
        test = blocked_mann_whitney(pairs)
        ahead = test.u / sum(len(x) * len(y) for x, y in pairs)
        row = {"network": name, "better": better, "equal": len(leads) - better - worse, "worse": worse}
        rows.append(row | {"ahead": rounded(ahead), "p_here": test.p, "p_elsewhere": sign_p(better, worse)})
    frame = pd.DataFrame(rows, columns=[name for name in JOINT if name not in {"here", "elsewhere"}])
    for where, leads in (("here", frame.ahead > 0.5), ("elsewhere", frame.better > frame.worse)):
        corrected = holm(frame[f"p_{where}"].tolist())
        words = leads.map({True: Verdict.better.value, False: Verdict.worse.value})
        is_shown = np.array(corrected) <= first.terms.alpha
        frame = frame.assign(**{f"p_{where}": corrected, where: words.where(is_shown, Verdict.undecided.value)})
    return frame[list(JOINT)].astype(JOINT)
