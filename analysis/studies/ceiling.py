"""The accuracy that no network can exceed on the data of a study, where that can be computed: simulated gratings."""

from typing import Any

from scipy.stats import binom

from analysis.statistics.effects import LEVEL
from tacevo.choices import SensorTask
from tacevo.config.schema import RunConfig
from tacevo.data.ideal import ideal_accuracy
from tacevo.parts.facts import source_facts
from tacevo.records import to_json
from tacevo.results.study import RecordedStudy
from tacevo.rounding import rounded


def ceiling_of(study: RecordedStudy, config: RunConfig) -> float | None:
    """Return the accuracy that no network can expect to exceed on a study's data, by the settings of its run."""
    settings: dict[str, Any] = {**to_json(config.data), **dict(study.other_data)}
    if not source_facts(settings["source"]).is_made or config.task.name != SensorTask.grating:
        return None
    return ideal_accuracy(settings["spacings_mm"])


def chance_at(ceiling: float, images: int) -> tuple[float, float]:
    """Return between which accuracies chance leaves an observer at the ceiling on so many images, 95 times of 100."""
    low, high = binom.interval(LEVEL, images, ceiling)
    return rounded(float(low) / images), rounded(float(high) / images)


def is_at_ceiling(study: RecordedStudy, score: float, margin: float) -> bool:
    """Return whether an accuracy lacks less to the ceiling than a margin, or than chance moves on the test images."""
    if study.ceiling is None:
        return False
    lowest, _ = chance_at(study.ceiling, study.data.counts[2])
    return score >= min(lowest, rounded(study.ceiling - margin))
