"""What the network that a job found is worth: its test score in the studies that its sweep stated beforehand.

The fitness that a search ends with is the lowest of many draws. This is one value a job of another kind: the network
with the best fitness is trained again with K fresh seeds, and the median of their test scores stands for the job.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median

from tacevo.errors import RunError
from tacevo.results.noise_runs import estimates_of
from tacevo.results.run import RecordedRun
from tacevo.results.study import PRIMARY
from tacevo.results.study_directory import is_stated, studies_of
from tacevo.results.study_lines import Design, FailedLine, Row, ScoreLine
from tacevo.results.trivial import metrics_from
from tacevo.rounding import rounded
from tacevo.storage.sweep_directory import Retraining
from tacevo.text import listed


@dataclass(frozen=True, slots=True, kw_only=True)
class JobScore:
    """The test score of what a job found."""

    #: Of its task: `mse` or `accuracy`.
    metric: str
    #: Of the test images, by training seed.
    values: tuple[float, ...]
    #: The id of the network; the baseline's where no other is better.
    network: str
    #: What a predictor scores that looks at no image; None where the study's scores do not tell, and equal but for the
    #: last digits in all studies on the same data.
    trivial: float | None = field(default=None, compare=False)

    @property
    def value(self) -> float:
        """The one value of the job: the median over the training seeds."""
        return rounded(median(self.values))


class FailedTestError(RunError):
    """What a job found did not train with every seed of its test; that is a result, and not a gap."""


def job_score(run: RecordedRun, stated: Retraining) -> JobScore:
    """Return the test score of the network that a run found.

    That is the best of its archive, by the fitness that the study chose by. The baseline counts as found, or a search
    that came to nothing better would be judged by something worse.

    Raises:
        FailedTestError: a training of this network failed.
        RunError: no sound study is as stated, or several are and do not agree.
    """
    sound, faults = [], []
    for directory in studies_of(run.path):
        record = directory.read()
        if record.run == run.digest and record.digest is not None and is_stated(record, stated):
            try:
                scores = directory.read_finished().scores
                sound.append(_score(run, scores.header, scores.rows))
            except RunError as error:
                faults.append(error)
    if not sound and faults:
        raise faults[-1]
    if len(set(sound)) != 1:
        raise RunError(
            f"{len(set(sound))} with different scores" if sound else "none of its settings",
            place=f"{run.path}/studies",
            expected="one finished study with the settings that the sweep states",
            remedy="delete all but one" if sound else f"`tacevo study sweep={run.path.parent}` makes it",
        )
    return sound[0]


def _score(run: RecordedRun, study: Design, rows: Sequence[Row]) -> JobScore:
    """Return the score of the best network of a study; what became of the others does not matter."""
    fitness = _fitness(run, study)
    # The baseline and the best elite; the earlier one wins a tie, as everywhere.
    found = [one for one in study.networks[:2] if one.id in fitness]
    if not found:
        got = f"{listed(one.id for one in study.networks[:2])} without a fitness"
        raise RunError(got, place=str(run.path), expected="a network that trained with every seed of the search")
    best = min(found, key=lambda one: (fitness[one.id], one.id))
    metric, own = PRIMARY[study.data.kind], [row for row in rows if row.network == best.name]
    if failed := [row for row in own if isinstance(row, FailedLine)]:
        raise FailedTestError(
            f"{listed(f'{row.reason} with seed {row.seed}' for row in failed)}",
            place=f"{run.path}, {best.name} ({best.id})",
            expected="a test score with every training seed",
            remedy="study the sweep again with more seconds= or memory_mib=",
        )
    values = tuple(row.metrics[metric] for row in own if isinstance(row, ScoreLine))
    if len(values) != study.seeds:
        raise RunError(f"{values}", place=f"{run.path}, {best.name}", expected=f"{study.seeds} scores")
    told = [row for row in rows if isinstance(row, ScoreLine)]
    trivial = metrics_from(told, study.data.names).get(metric)
    return JobScore(metric=metric, values=values, network=best.id, trivial=trivial)


def _fitness(run: RecordedRun, study: Design) -> dict[str, float]:
    """Return what the networks of a study were chosen by."""
    if not study.chosen_by:
        # A baseline that failed when it was trained again stands in the study by its first draw, and found nothing.
        return {network.id: network.fitness for network in study.networks if network.id in run.fitness}
    return estimates_of(run.path, study.chosen_by)
