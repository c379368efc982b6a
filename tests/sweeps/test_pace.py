"""Promise: the time that a sweep still takes is told by the trainings that were made, and by nothing else."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from ledger_lines import ended, header, rejected, trained
from sweeps import SHARED, composed

from tacevo.costs import Spending
from tacevo.storage.ledger import sealed_text
from tacevo.storage.sweep_directory import Job, SweepDirectory
from tacevo.sweeps.pace import seconds_left
from tacevo.sweeps.pace import trained as has_trained
from tacevo.sweeps.sweeping import plan

#: Of a finished job: trainings, and the seconds that each of them took, one after the other.
MANY, SECONDS = 10, 30.0


def finish(directory: SweepDirectory, job: Job, made: int) -> None:
    """Write what a finished job leaves: `MANY` trainings, of which so many were made now, and a rejected answer."""
    run = directory.run(job)
    run.path.mkdir(parents=True)
    names = [f"g00s{slot:02d}" for slot in range(MANY)]
    lines = [trained(name, 0.5) for name in names]
    text, _ = sealed_text([header(), *lines, rejected("g00s99", "policy", "forbidden_import"), ended(0)])
    run.write_text("ledger.jsonl", text)
    for number, name in enumerate([*names, "g00s99"]):
        run.add_timing(Spending(), id=name, seconds=SECONDS, cpu_seconds=1.0 if number < made else None)


@pytest.fixture
def jobs() -> list[Job]:
    """Return three jobs."""
    return [*plan(SHARED, [(f"seed={seed}",) for seed in range(3)])]


@pytest.mark.parametrize(("made", "per_training"), [(0, None), (1, 300.0), (5, 60.0), (10, 30.0)])
def test_recalled_trainings_enter_no_estimate(
    tmp_path: Path, jobs: list[Job], made: int, per_training: float | None
) -> None:
    """A job that recalled all gives none, and one that recalled most does not make the others look short."""
    directory, configs = SweepDirectory(tmp_path), dict.fromkeys(jobs, composed(*SHARED))
    began = datetime.now(UTC)
    finish(directory, jobs[0], made)
    now = datetime.now(UTC) + timedelta(seconds=270)  # the first one began 30 s before its line was written
    left = seconds_left(directory, configs, jobs[:1], jobs[:1], began=began, now=now)
    assert has_trained(directory.run(jobs[0]), configs[jobs[0]], began) == (made > 0)
    assert left == (None if per_training is None else pytest.approx(2 * MANY * per_training, rel=0.05))
    finish(directory, jobs[1], 0)
    among = seconds_left(directory, configs, jobs[:2], jobs[:2], began=began, now=now)
    assert among == (None if left is None else pytest.approx(left / 2, rel=0.05))
    assert seconds_left(directory, configs, jobs[:1], jobs, began=began, now=now) is None


def test_trainings_of_an_earlier_command_enter_no_estimate(tmp_path: Path, jobs: list[Job]) -> None:
    """What a stopped sweep trained yesterday says nothing of its pace today."""
    directory, configs = SweepDirectory(tmp_path), dict.fromkeys(jobs, composed(*SHARED))
    finish(directory, jobs[0], MANY)
    began = datetime.now(UTC) + timedelta(seconds=1)
    assert seconds_left(directory, configs, jobs[:1], jobs[:1], began=began, now=began) is None
