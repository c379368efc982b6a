"""A finished study as statistics see it: the scores of every network under every training seed, checked to be whole."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tacevo.errors import RunError
from tacevo.records import Kind, to_json
from tacevo.results.study_directory import FinishedStudy, StudyDirectory
from tacevo.results.study_lines import BASELINE, Design, FailedLine, ScoreLine, StudyTerms
from tacevo.storage.canonical import content_hash
from tacevo.text import listed
from tacevo.training.metrics import contradiction

#: Rows that a message names.
MOST = 6

_AGAIN = "delete its directory; `tacevo study` writes it again from the store"

#: The metric that a study is judged by: the paper's test metric of each kind of task.
PRIMARY = {Kind.regression: "mse", Kind.classification: "accuracy"}

#: The test metric that is the loss of training.
LOSS = {Kind.regression: "mse", Kind.classification: "cross_entropy"}

#: Whether less of such a metric is better.
LOWER_IS_BETTER = {"mse": True, "accuracy": False}


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedStudy(Design):
    """A finished study as statistics use it: its design and one score for each network and seed."""

    #: The level and the margin by which it is judged; what has none is not a study.
    terms: StudyTerms
    #: The units of the recording, one for each regressed value, empty where none is stated; () for classification.
    units: tuple[str, ...]
    #: Units of the recording for one unit of training, one for each regressed value; () for classification.
    scale: tuple[float, ...]
    #: Each is of the weights of the epoch with the lowest validation loss. Metrics are those of the test split, by
    #: name: `mse`, `mse_Fx`, `mae`, `rmse`, `r2` ...; or `accuracy`, `macro_f1`, `cross_entropy`. A confusion counts
    #: test images by (true class, predicted class).
    scores: tuple[ScoreLine, ...]
    #: The accuracy that no network can expect to exceed on these data; None where it is not known.
    ceiling: float | None = None
    #: True where the settings of the run group the images, and the study, of an earlier release, does not record the
    #: groups.
    lacks_groups: bool = False

    @property
    def kind(self) -> Kind:
        """The kind of the task."""
        return self.data.kind

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the regressed values or classes."""
        return self.data.names

    @property
    def fingerprint(self) -> str:
        """The fingerprint of the data set."""
        return self.data.fingerprint

    @property
    def primary(self) -> str:
        """The metric that networks are compared by."""
        return PRIMARY[self.kind]

    def values(self, network: str, metric: str) -> NDArray[np.float64]:
        """Return a metric of a network, shape (S,), in the order of the seeds."""
        return np.array([score.metrics[metric] for score in self._of(network)], dtype=np.float64)

    def median_seed(self, network: str) -> int:
        """Return the seed that stands for a network: the first one whose primary metric is the median of all.

        Of an even number of seeds, the median is the lower one of the two in the middle, so that a seed has it.
        """
        ranked = sorted(self._of(network), key=lambda score: score.metrics[self.primary])
        median = ranked[(len(ranked) - 1) // 2].metrics[self.primary]
        return next(score.seed for score in self._of(network) if score.metrics[self.primary] == median)

    def _of(self, network: str) -> list[ScoreLine]:
        """List the scores of a network, in the order of the seeds."""
        return sorted((score for score in self.scores if score.network == network), key=lambda score: score.seed)


def load_study(path: Path) -> RecordedStudy:
    """Read the directory of a finished study, `RUN/studies/NAME`.

    Raises:
        RunError: it does not hold a study, is not finished or was edited; or as `as_study`.
    """
    return as_study(StudyDirectory(path).read_finished())


def as_study(finished: FinishedStudy) -> RecordedStudy:
    """Return a study whose files were read.

    Raises:
        RunError: it tests nothing, or has not one score for each network and seed; the message names the rows.
    """
    path, record, header = finished.path, finished.record, finished.header
    _check_failed(path, [row for row in finished.rows if isinstance(row, FailedLine)])
    facts = header.data
    if header.terms is None:
        got = f"a {header.what}, which has none"
        raise RunError(got, place=str(path), expected="a study with test scores")
    for name in ("units", "scale"):
        given: tuple[object, ...] = getattr(record, name)
        if len(given) not in {0, len(facts.names)}:
            expected = f"one for each of {listed(facts.names)}"
            raise RunError(listed(map(str, given)), place=f"{path}/study.json, {name}", expected=expected)
    study = RecordedStudy(
        **{field.name: getattr(header, field.name) for field in fields(Design)},
        units=record.units,
        scale=record.scale,
        scores=tuple(row for row in finished.rows if isinstance(row, ScoreLine)),
    )
    check_study(study)
    return study


def check_alike(studies: Sequence[RecordedStudy]) -> None:
    """Check that studies of one task, each on its run's own data, were trained alike and on the same data.

    Each task is compared with itself. Studies on other data are not compared.

    Raises:
        RunError: recipe, numerics, data fingerprint or number of seeds differ; the message names the rows.
    """
    first: dict[str, RecordedStudy] = {}
    for study in studies:
        if study.other_data:
            continue
        other = first.setdefault(study.task, study)
        for field in ("fingerprint", "recipe", "numerics", "seeds"):
            ours, theirs = getattr(other, field), getattr(study, field)
            if ours != theirs:
                raise RunError(
                    f"{theirs} for {_networks(study)}",
                    place=f"the studies of {study.task}, {field}",
                    expected=f"{ours} as for {_networks(other)}",
                    remedy="study both runs alike",
                )


def _networks(study: RecordedStudy) -> str:
    return f"{listed(network.name for network in study.networks)} of run {study.run[:12]}"


def _check_failed(path: Path, failed: Sequence[FailedLine]) -> None:
    """Check that no training failed."""
    if failed:
        rows = listed((f"{row.network} with seed {row.seed}" for row in failed), most=MOST)
        reasons = listed(sorted({row.reason for row in failed}))
        raise RunError(
            f"{len(failed)} that failed ({reasons}): {rows}",
            place=str(path),
            expected="a training of every network with every seed, without which no statistics are right",
            remedy="study again with more seconds= or memory_mib=, or with fewer elites=",
        )


def check_study(study: RecordedStudy) -> None:
    """Check that statistics can be made of a study.

    Raises:
        RunError: the baseline is not the first network; scores are missing, twice there, of an unknown network or seed,
            or of different metrics; or a metric contradicts others, or the confusion. The message names the rows.
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
            f"{words}: {listed((f'{name} with seed {seed}' for name, seed in rows), most=MOST)}"
            for words, rows in faults.items()
            if rows
        )
        raise RunError(
            "; ".join(told),
            place=place,
            expected="one score for every network and seed",
            remedy=_AGAIN,
        )
    for score in study.scores:
        found = contradiction(study.kind, study.names, score.metrics, score.confusion, images=study.data.counts[2])
        if found is not None:
            what, got, expected = found
            row = f"{place}, {score.network} with seed {score.seed}, {what}"
            raise RunError(got, place=row, expected=expected, remedy=_AGAIN)


def is_alone(study: RecordedStudy, others: Iterable[RecordedStudy]) -> bool:
    """Return whether no other study has its networks, alike, on other data."""
    return not any(shared_terms(one) == shared_terms(study) and one.fingerprint != study.fingerprint for one in others)


def shared_terms(study: RecordedStudy) -> str:
    """Name what a study has in common with itself on other data; a plan is of one of them, and changes no score."""
    kept = {field.name for field in fields(Design)} - {"data", "other_data", "plan"}
    return content_hash({name: to_json(getattr(study, name)) for name in kept})
