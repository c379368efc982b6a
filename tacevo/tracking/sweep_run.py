"""The run that stands for a sweep in an MLflow store: its searches are nested under it."""

from pathlib import Path

from mlflow import MlflowClient

from tacevo.storage.canonical import content_hash
from tacevo.storage.sweep_directory import Job, SweepDirectory
from tacevo.tracking.lock import alone
from tacevo.tracking.mlflow_store import PARENT_TAG, find_or_create_run, log
from tacevo.tracking.params import shorten

#: Tags of a sweep's run: what it is found by; of it and of its searches: the sweep's name, the arm, the seed.
SWEEP_KEY_TAG = "tacevo.sweep_key"

SWEEP_TAG = "tacevo.sweep"

ARM_TAG = "tacevo.arm"

SEED_TAG = "tacevo.seed"


def find_sweep(run_dir: Path) -> tuple[SweepDirectory, Job] | None:
    """Find the sweep of which a run is a job, and that job: the directory above, if its sweep.json lists the run.

    Raises:
        RunError: sweep.json is damaged.
    """
    path = run_dir.resolve()
    directory = SweepDirectory(path.parent)
    jobs = directory.read().jobs if directory.is_one else ()
    return next(((directory, job) for job in jobs if job.name == path.name), None)


def join_sweep(client: MlflowClient, experiment: str, directory: SweepDirectory, job: Job) -> dict[str, str]:
    """Find or create the run of a sweep, as running; return the tags that nest the search of a job under it."""
    sweep, name = directory.read(), directory.path.name
    key = content_hash([name, sweep.jobs[0].config])  # jobs are only added, so the first one stays
    with alone(directory.path):  # jobs that start at the same moment share the sweep's run
        run = find_or_create_run(client, experiment, tag=SWEEP_KEY_TAG, key=key, name=name)
        parent: str = run.info.run_id
        if "overrides" not in run.data.params:
            client.set_tag(parent, SWEEP_TAG, name)
            log(client, parent, {"overrides": shorten(" ".join(sweep.overrides))}, ())
    client.update_run(parent, status="RUNNING")
    return {PARENT_TAG: parent, SWEEP_TAG: name, ARM_TAG: job.arm, SEED_TAG: str(job.seed)}


def leave_sweep(client: MlflowClient, sweep: str, directory: SweepDirectory) -> None:
    """End the run of a sweep if all of its jobs are finished, including those that were added meanwhile."""
    if all((directory.path / job.name / "summary.md").exists() for job in directory.read().jobs):
        client.set_terminated(sweep, "FINISHED")
