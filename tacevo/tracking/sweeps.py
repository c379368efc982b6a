"""The run that stands for a sweep in an MLflow store: its searches are nested under it.

What it promises: one such run a sweep, whichever of its jobs' mirrors comes first, and however many at once on one
machine. On several machines this holds where their shared file system has locks; where it has none, two may be made,
of which one is left, with the searches of both.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mlflow import MlflowClient

from tacevo.errors import RunError
from tacevo.redaction import without_password
from tacevo.search.files import finished_digest
from tacevo.storage.canonical import content_hash
from tacevo.storage.files import alone
from tacevo.storage.sweep_directory import Job, SweepDirectory
from tacevo.tracking.client import PARENT_TAG, claim, label, log
from tacevo.tracking.entries import shorten
from tacevo.tracking.identity import folder_id

#: Tags of a sweep's run: what it is found by; of it and of its searches: the sweep's name, the arm, the seed.
SWEEP_KEY_TAG = "tacevo.sweep_key"

SWEEP_TAG = "tacevo.sweep"

ARM_TAG = "tacevo.arm"

SEED_TAG = "tacevo.seed"


@dataclass(frozen=True, slots=True, kw_only=True)
class Membership:
    """The sweep that a run belongs to."""

    directory: SweepDirectory
    overrides: tuple[str, ...]
    #: The job whose run it is.
    job: Job

    @property
    def name(self) -> str:
        """What the sweep is called: the name of its folder."""
        return self.directory.path.name

    @property
    def key(self) -> str:
        """What the sweep is found by: its folder's id or, where none can be written, its folder's name.

        Not by what its jobs share, of which workers, stores, tracking and budgets may change.
        """
        return content_hash(["sweep", folder_id(self.directory.path) or self.name])


def membership(run_dir: Path) -> Membership | None:
    """Find the sweep of which a run is a job: its folder lies above, and names it; None where there is none.

    Raises:
        RunError: the sweep's folder is damaged.
    """
    path = run_dir.resolve()
    directory = SweepDirectory(path.parent)
    if not directory.is_one:
        return None
    overrides, jobs = directory.read()
    shown = tuple(map(without_password, overrides))
    return next(
        (Membership(directory=directory, overrides=shown, job=job) for job in jobs if job.name == path.name),
        None,
    )


def nest(client: MlflowClient, experiment: str, member: Membership, tag: Callable[[Mapping[str, str]], None]) -> None:
    """Bring a search under its sweep's run.

    It is done twice: where two machines without common locks make the sweep's run at once, the second may take the
    first one's away just before the search is tagged with it; by then it finds its own.

    Args:
        client: the store.
        experiment: the experiment's id.
        member: the sweep.
        tag: sets tags of the search's run.
    """
    for _ in range(2):
        tag(join_sweep(client, experiment, member))


def join_sweep(client: MlflowClient, experiment: str, member: Membership) -> dict[str, str]:
    """See that the sweep has its run, which is at work now; give the tags of the search that belongs to it."""
    with alone(member.directory.path):
        run = claim(client, experiment, tag=SWEEP_KEY_TAG, key=member.key, name=member.name)
        label(client, run, {SWEEP_TAG: member.name})
        if "overrides" not in run.data.params:
            log(client, run.info.run_id, {"overrides": shorten(" ".join(member.overrides))}, ())
        client.update_run(run.info.run_id, status="RUNNING", name=member.name)
    return {
        PARENT_TAG: run.info.run_id,
        SWEEP_TAG: member.name,
        ARM_TAG: member.job.arm,
        SEED_TAG: str(member.job.seed),
    }


def leave_sweep(client: MlflowClient, experiment: str, member: Membership) -> None:
    """End the sweep's run where all of its jobs are finished, also those added meanwhile; else it goes on."""
    _, jobs = member.directory.read()
    if not all(_is_finished(member.directory, job) for job in jobs):
        return
    with alone(member.directory.path):
        run = claim(client, experiment, tag=SWEEP_KEY_TAG, key=member.key, name=member.name)
        client.set_terminated(run.info.run_id, "FINISHED")


def _is_finished(directory: SweepDirectory, job: Job) -> bool:
    try:
        return finished_digest(directory.run(job)) is not None
    except RunError:  # damaged
        return False
