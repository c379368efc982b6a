"""The test scores of the networks that a job found, in the studies that its sweep stated beforehand.

The fitness that a search ends with is the lowest of many draws. This is one value a job of another kind: the networks
with the best fitness are trained again with K fresh seeds each, and what they score stands for the job.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean, median

from tacevo.errors import RunError
from tacevo.evolution.archive import best_distinct
from tacevo.results.run import RecordedRun
from tacevo.results.study import LOSS, PRIMARY
from tacevo.results.study_directory import estimates_of, is_stated, studies_of
from tacevo.results.study_lines import Design, FailedLine, Row, ScoreLine, is_late
from tacevo.results.trivial import metrics_from
from tacevo.rounding import rounded
from tacevo.storage.sweep_directory import Retraining
from tacevo.text import counted, listed

#: A metric of each network, by training seed.
_Scores = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class JobScore:
    """The test scores of what a job found."""

    #: The primary metric of its task: `mse` or `accuracy`.
    metric: str
    #: The ids of the networks, best first, as many as the sweep states. The baseline is one of them where it is among
    #: the best; where the job found too few networks, its id is repeated until there are enough.
    networks: tuple[str, ...]
    #: The metric over the test images, for each network, then for each training seed.
    values: _Scores
    #: The loss of training, MSE or cross-entropy (nats), over the test images, in the same order.
    losses: _Scores
    #: The number of trainings whose best epoch lies in the last tenth.
    late: int
    #: How often the baseline stands for a network that the job did not find.
    lacking: int = 0
    #: The score of a predictor that looks at no image, by metric; empty where the study's scores do not tell it. All
    #: studies on the same data have the same one, but for the last digits.
    trivial: Mapping[str, float] = field(default_factory=dict, compare=False)

    @property
    def value(self) -> float:
        """The mean over the networks of each one's median over the training seeds."""
        return rounded(fmean(map(median, self.values)))

    @property
    def loss(self) -> float:
        """The geometric mean of the losses: over the training seeds of a network, then over the networks."""
        every = [loss for losses in self.losses for loss in losses]
        return rounded(math.exp(fmean(map(math.log, every)))) if min(every) > 0 else 0.0


class FailedTestError(RunError):
    """A network that a job found did not train with every seed of its test; that is a result, and not a gap."""


def job_score(run: RecordedRun, stated: Retraining) -> JobScore:
    """Return the test scores of the networks that a run found.

    They are the best of its archive, by the fitness that the study chose by. The baseline counts as found, or a search
    that came to nothing better would be judged by something worse. Where fewer than are stated have a source of their
    own, the baseline takes the places that are left: the mean of fewer networks is that of better ranks, so a search
    would gain by finding few.

    Raises:
        FailedTestError: a training of these networks failed.
        RunError: no sound study is as stated, or several are and do not agree.
    """
    sound, faults = [], []
    for directory in studies_of(run.path):
        record = directory.read()
        if record.run == run.digest and record.digest is not None and is_stated(record, stated):
            try:
                study = directory.read_finished()
                if len(study.header.networks) > min(stated.tested, _offered(run, study.header)):
                    sound.append(_score(run, study.header, study.rows, stated.tested))
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


def _score(run: RecordedRun, study: Design, rows: Sequence[Row], count: int) -> JobScore:
    """Return the scores of so many networks of a study, the best; what became of the others does not matter."""
    fitness = _fitness(run, study)
    # The baseline and the best elites, in their order; the earlier one wins a tie, as everywhere.
    baseline, offered = study.networks[0], [one for one in study.networks[: count + 1] if one.id in fitness]
    best = sorted(offered, key=lambda one: (fitness[one.id], one.id))[:count]
    if len(best) < count and baseline not in best:
        got = f"{len(best)}, and {baseline.id} without a fitness"
        expected = f"{counted(count, 'network')} that trained with every seed of the search"
        remedy = "study the sweep with fewer elites=" if count > 1 else "leave its arm out of arms="
        raise FailedTestError(got, place=str(run.path), expected=expected, remedy=remedy)
    told = [row for row in rows if isinstance(row, ScoreLine)]
    networks = []
    for network in best:
        failed = [row for row in rows if row.network == network.name and isinstance(row, FailedLine)]
        place = f"{run.path}, {network.name} ({network.id})"
        if failed:
            raise FailedTestError(
                f"{listed(f'{row.reason} with seed {row.seed}' for row in failed)}",
                place=place,
                expected="a test score with every training seed",
                remedy="study the sweep again with more seconds= or memory_mib=",
            )
        networks.append([row for row in told if row.network == network.name])
        if len(networks[-1]) != study.seeds:
            raise RunError(f"{len(networks[-1])}", place=place, expected=f"{study.seeds} scores")
    late = sum(is_late(row, study.recipe.epochs) for own in networks for row in own)
    left = count - len(best)
    networks += [networks[best.index(baseline)] for _ in range(left)]
    best += [baseline] * left
    kind = study.data.kind
    values, losses = (
        tuple(tuple(row.metrics[metric] for row in own) for own in networks) for metric in (PRIMARY[kind], LOSS[kind])
    )
    return JobScore(
        metric=PRIMARY[kind],
        networks=tuple(network.id for network in best),
        values=values,
        losses=losses,
        late=late,
        lacking=max(0, count - sum(one is not baseline for one in offered)),
        trivial=metrics_from(told, study.data.names),
    )


def _offered(run: RecordedRun, study: Design) -> int:
    """Count the elites that a study could choose from: those of different sources that are not the baseline's."""
    sources = {candidate.id: candidate.source for candidate in run.candidates}
    known = estimates_of(run.path, study) if study.chosen_by else run.fitness
    entries = [(known[elite.id], elite.id, sources[elite.id]) for elite in run.elites if elite.id in known]
    return len(best_distinct(entries, run.baseline.source))


def _fitness(run: RecordedRun, study: Design) -> Mapping[str, float]:
    """Return what the networks of a study were chosen by."""
    if not study.chosen_by:
        return {network.id: network.fitness for network in study.networks}
    return estimates_of(run.path, study)
