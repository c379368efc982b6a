"""The state of a job is what its directory shows."""

import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from sweeps import SHARED, begin, composed

from tacevo.config.identity import config_hash
from tacevo.evolution.run_files import finished_digest
from tacevo.results.sweep import Standing, state_of
from tacevo.storage.sweep_directory import Job, SweepDirectory, SweepRecord
from tacevo.sweeps.status import best_in_words, continuing, describe_jobs, status_of
from tacevo.sweeps.sweeping import part, plan


@pytest.fixture
def job() -> Job:
    """Return a job."""
    (job,) = plan(SHARED, [("ablation=none", "seed=0")])
    return job


def test_job_goes_through_its_standings(tmp_path: Path, job: Job) -> None:
    """Not begun, running, stopped, failed, running again, finished."""
    directory = SweepDirectory(tmp_path)
    assert status_of(directory, job).standing is Standing.waiting
    with directory.run(job).locked():
        assert status_of(directory, job).standing is Standing.running
    begin(directory, job, finished=False)
    stopped = status_of(directory, job)
    assert (stopped.standing, stopped.lines, stopped.best, stopped.digest) == (Standing.stopped, 2, 0.25, "")
    directory.fail(job, "the disk is full")
    failed = status_of(directory, job)
    assert (failed.standing, failed.reason) == (Standing.failed, "the disk is full")
    with directory.run(job).locked():
        assert status_of(directory, job).standing is Standing.running
    begin(directory, job)
    finished = status_of(directory, job)
    assert (finished.standing, finished.reason) == (Standing.finished, "")
    assert finished.digest == finished_digest(directory.run(job))


def test_damage_of_an_unfinished_job_stops_no_reader_of_a_sweep(tmp_path: Path, job: Job) -> None:
    """Its ledger is not needed to say that it is missing."""
    directory = SweepDirectory(tmp_path)
    begin(directory, job, finished=False)
    directory.run(job).ledger.write_text("{}\n")
    assert state_of(directory, job) == (Standing.stopped, "")


def test_digest_that_is_not_the_ledgers_finishes_nothing(tmp_path: Path, job: Job) -> None:
    """A job whose ledger lost its end is to be run again."""
    directory = SweepDirectory(tmp_path)
    begin(directory, job)
    ledger = directory.run(job).ledger
    ledger.write_bytes(b"".join(ledger.read_bytes().splitlines(keepends=True)[:-1]))
    assert status_of(directory, job).standing is Standing.stopped


@pytest.mark.parametrize(
    ("file", "text", "reason"),
    [
        ("ledger.jsonl", "{}\n", "ledger.jsonl, line 1: expected a line of a known kind"),
        ("run.json", "[", "run.json: expected JSON"),
        ("run.json", '{"schema": 1}', "run.json, name: expected a value"),
    ],
)
def test_directory_that_cannot_be_read_is_a_failure(
    file: str, text: str, reason: str, tmp_path: Path, job: Job
) -> None:
    """Damage is shown with its place, and hides no other job."""
    directory = SweepDirectory(tmp_path)
    begin(directory, job)
    (directory.run(job).path / file).write_text(text)
    status = status_of(directory, job)
    assert status.standing is Standing.failed
    assert reason in status.reason


def test_run_of_another_configuration_is_not_the_job(tmp_path: Path, job: Job) -> None:
    """Its digest is not shown as the job's."""
    directory = SweepDirectory(tmp_path)
    begin(directory, job, [*SHARED, "search.candidates=3"])
    status = status_of(directory, job)
    assert (status.standing, status.digest) == (Standing.failed, "")
    assert "expected a run of the job none-seed0, whose configuration has the hash " in status.reason


@pytest.mark.few(3)
@pytest.mark.parametrize(
    "change",
    [
        "seed=1",
        "search.generations=1",
        "search.training_flops=1e12",
        "data.images=50",
        "data.test_part=0.3",
        "task.baseline=other.py",
    ],
)
def test_hash_follows_what_decides_results(change: str) -> None:
    """What ends the search and the data count, which a ledger's identity has by other means."""
    assert config_hash(composed(*SHARED, change)) != config_hash(composed(*SHARED))


@pytest.mark.few(1)
@pytest.mark.parametrize("change", ["executor.workers=1", "store.root=else", "run.dir=else", "tracking=mlflow"])
def test_hash_leaves_out_where_a_job_is_computed(change: str) -> None:
    """A job that was finished with two workers is not repeated with four."""
    assert config_hash(composed(*SHARED, change)) == config_hash(composed(*SHARED))


@pytest.mark.parametrize(("trivial", "at_chance"), [(0.26, True), (0.5, False), (None, False)])
def test_job_that_learned_nothing_is_said_to_be_at_chance(
    trivial: float | None, at_chance: bool, tmp_path: Path, job: Job
) -> None:
    """In its row and its line; of a job that is not finished, and of an earlier release's, nothing is known."""
    directory = SweepDirectory(tmp_path)
    begin(directory, job)
    run = directory.run(job)
    run.write_run(replace(run.read_run(), trivial=trivial))
    status = status_of(directory, job)
    assert status.at_chance is at_chance
    assert ("at chance" in best_in_words(status)) is at_chance
    assert best_in_words(status) in describe_jobs([status])
    begin(directory, job, finished=False)
    assert not status_of(directory, job).at_chance


def test_command_that_continues_a_sweep_asks_for_its_jobs(tmp_path: Path) -> None:
    """The same ones, no more and no fewer; where no command can, that is said."""
    directory = SweepDirectory(tmp_path / "my sweep")
    shared, own = part([*SHARED, "ablation=none,fixed_temperature", "seed=0,1"], ())
    jobs = tuple(plan(shared, own))
    directory.write(SweepRecord(overrides=shared, jobs=jobs))
    _, command, several, *settings, into, place = shlex.split(continuing(directory, "tacevo"))
    assert (command, several, into, place) == ("search", "-m", "--into", str(directory.path))
    again, owns = part(settings, ())
    assert (again, set(plan(again, owns))) == (shared, set(jobs))
    directory.write(SweepRecord(overrides=shared, jobs=jobs[:3]))
    assert "search" not in continuing(directory, "tacevo")
