"""Promise: no job that a cluster took is left behind, and how the cluster ended one is not put down to its search."""

import signal
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from tacevo.storage.sweep_directory import Failure, Job, SweepDirectory, SweepRecord

slurm = pytest.importorskip("tacevo.sweeps.slurm", reason="submitit is an extra")
UncompletedJobError = pytest.importorskip("submitit.core.utils").UncompletedJobError

JOB = Job(name="none-seed0", arm="none", seed=0, overrides=(), config="a" * 64)


class Task:
    """A job that Slurm took; Ctrl-C comes when its number is first read."""

    is_cancelled = is_heard = False
    paths = SimpleNamespace(stderr=Path("nowhere"))

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


@pytest.fixture
def launching(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[object], SweepDirectory]:
    """Return what launches the job as a task of a Slurm whose node died."""
    monkeypatch.setattr(slurm, "_TICK", 0.0)
    monkeypatch.setattr(slurm, "_QUEUE", ["echo", "7 NODE_FAIL"])

    def launch(task: object) -> SweepDirectory:
        monkeypatch.setattr(slurm, "executor_of", lambda *_: SimpleNamespace(map_array=lambda *_: [task]))
        slurm.launch_on_slurm(SweepDirectory(tmp_path), [JOB], {}, print)
        return SweepDirectory(tmp_path)

    return launch


def test_ctrl_c_before_the_first_look_cancels_what_was_submitted(
    launching: Callable[[object], SweepDirectory],
) -> None:
    """The cluster has the job by then, and would run it for nobody."""
    with pytest.raises(KeyboardInterrupt):
        launching(task := Task())
    assert task.is_cancelled


def test_what_the_cluster_says_of_a_job_is_no_failure_of_its_search(
    launching: Callable[[object], SweepDirectory], tmp_path: Path
) -> None:
    """The record says so, for whoever compares arms, with the last line of the job's own."""
    (tmp_path / "stderr").write_text("the node is gone\nsrun: error: again\n")
    directory = launching(SimpleNamespace(job_id="7", paths=SimpleNamespace(stderr=tmp_path / "stderr")))
    reason = "Slurm: NODE_FAIL (the node is gone)"
    assert directory.failure(JOB) == Failure(job=JOB.name, reason=reason, by_scheduler=True)


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
