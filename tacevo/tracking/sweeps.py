"""The run that stands for a sweep in an MLflow store: its searches are nested under it."""

from dataclasses import dataclass
from pathlib import Path

from mlflow import MlflowClient

from tacevo.storage.canonical import content_hash
from tacevo.storage.sweep_directory import Job, SweepDirectory
from tacevo.tracking.client import PARENT_TAG, find_or_create_run, log
from tacevo.tracking.entries import shorten
from tacevo.tracking.lock import alone

#: Tags of a sweep's run: what it is found by; of it and of its searches: the sweep's name, the arm, the seed.
SWEEP_KEY_TAG = "tacevo.sweep_key"

SWEEP_TAG = "tacevo.sweep"

ARM_TAG = "tacevo.arm"

SEED_TAG = "tacevo.seed"


@dataclass(frozen=True, slots=True, kw_only=True)
class Membership:
    """The sweep that a run belongs to, and the run's job there."""

    directory: SweepDirectory
    job: Job

    @property
    def name(self) -> str:
        """The name of the sweep's directory."""
        return self.directory.path.name


def find_membership(run_dir: Path) -> Membership | None:
    """Find the sweep of which a run is a job: the directory above, if its sweep.json lists the run.

    Raises:
        RunError: sweep.json is damaged.
    """
    path = run_dir.resolve()
    directory = SweepDirectory(path.parent)
    jobs = directory.read().jobs if directory.is_one else ()
    return next((Membership(directory=directory, job=job) for job in jobs if job.name == path.name), None)


def join_sweep(client: MlflowClient, experiment: str, member: Membership) -> dict[str, str]:
    """Find or create the run of a sweep, as running; return the tags that nest a search under it."""
    sweep = member.directory.read()
    key = content_hash([member.name, sweep.jobs[0].config])  # jobs are only added, so the first one stays
    with alone(member.directory.path):  # jobs that start at the same moment share the sweep's run
        run = find_or_create_run(client, experiment, tag=SWEEP_KEY_TAG, key=key, name=member.name)
        parent: str = run.info.run_id
        if "overrides" not in run.data.params:
            client.set_tag(parent, SWEEP_TAG, member.name)
            log(client, parent, {"overrides": shorten(" ".join(sweep.overrides))}, ())
    client.update_run(parent, status="RUNNING")
    return {
        PARENT_TAG: parent,
        SWEEP_TAG: member.name,
        ARM_TAG: member.job.arm,
        SEED_TAG: str(member.job.seed),
    }


def leave_sweep(client: MlflowClient, sweep: str, directory: SweepDirectory) -> None:
    """End the run of a sweep if all of its jobs are finished, including those that were added meanwhile."""
    if all((directory.path / job.name / "summary.md").exists() for job in directory.read().jobs):
        client.set_terminated(sweep, "FINISHED")
