"""Promise: whatever ends the submission of a sweep's jobs, none that the cluster took is left behind."""

import signal
from pathlib import Path
from types import SimpleNamespace

import pytest

from tacevo.storage.sweep_directory import Job, SweepDirectory

slurm = pytest.importorskip("tacevo.sweeps.slurm", reason="submitit is an extra")


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
    job = Job(name="none-seed0", arm="none", seed=0, overrides=(), config="a" * 64)
    with pytest.raises(KeyboardInterrupt):
        slurm.launch_on_cluster(SweepDirectory(tmp_path), [job], "submitit_local", {}, print)
    assert task.is_cancelled
