"""Promise: no job that a cluster took is left behind, and how the cluster ended one is not put down to its search."""

import signal
from pathlib import Path
from types import SimpleNamespace

import pytest

from tacevo.storage.sweep_directory import Failure, Job, SweepDirectory, SweepRecord

slurm = pytest.importorskip("tacevo.sweeps.slurm", reason="submitit is an extra")
UncompletedJobError = pytest.importorskip("submitit.core.utils").UncompletedJobError

JOB = Job(name="none-seed0", arm="none", seed=0, overrides=(), config="a" * 64)


class Task:
    """A job that the cluster took; Ctrl-C comes when its number is first read."""

    is_cancelled = False
    is_heard = False

    @property
    def job_id(self) -> str:
        """Its number."""
        if not self.is_heard:
            self.is_heard = True
            signal.raise_signal(signal.SIGINT)
        return "7"

    def cancel(self, *, check: bool) -> None:
        """Keep that it was cancelled."""
        assert not check
        self.is_cancelled = True

    def done(self) -> bool:
        """Return whether it has ended."""
        return self.is_cancelled

    def exception(self) -> None:
        """Return what went wrong."""


def test_ctrl_c_before_the_first_look_cancels_what_was_submitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cluster has the job by then, and would run it for nobody."""
    task = Task()
    executor = SimpleNamespace(map_array=lambda *_: [task])
    monkeypatch.setattr(slurm, "executor_of", lambda *_: executor)
    monkeypatch.setattr(slurm, "_TICK", 0.0)
    with pytest.raises(KeyboardInterrupt):
        slurm.launch_on_cluster(SweepDirectory(tmp_path), [JOB], "submitit_local", {}, print)
    assert task.is_cancelled


def test_what_the_cluster_says_of_a_job_is_no_failure_of_its_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The record says so, for whoever compares arms."""
    task = SimpleNamespace(job_id="7", done=lambda: True, exception=lambda: RuntimeError("the node is gone\nat ..."))
    monkeypatch.setattr(slurm, "executor_of", lambda *_: SimpleNamespace(map_array=lambda *_: [task]))
    monkeypatch.setattr(slurm, "_TICK", 0.0)
    directory = SweepDirectory(tmp_path)
    slurm.launch_on_cluster(directory, [JOB], "submitit_local", {}, print)
    assert directory.failure(JOB) == Failure(job=JOB.name, reason="the node is gone", by_scheduler=True)


def test_search_that_runs_out_of_the_schedulers_time_did_not_fail(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the node, too, where submitit's signal ends the wait for the search; one that exits by itself has failed."""
    directory = SweepDirectory(tmp_path)
    directory.write(SweepRecord(overrides=(), jobs=(JOB,)))
    directory.launch.mkdir()
    directory.log(JOB).write_text("error: no answer came")

    def warned() -> int:
        raise UncompletedJobError

    for wait, by_scheduler in ((warned, True), (lambda: 1, False)):
        search = SimpleNamespace(wait=wait)
        monkeypatch.setattr(slurm, "start", lambda *_, search=search: search)
        monkeypatch.setattr(slurm, "stop", lambda _: None)
        slurm.SearchJob()(tmp_path, JOB.name)
        failure = directory.failure(JOB)
        assert failure is not None
        assert failure.by_scheduler is by_scheduler
