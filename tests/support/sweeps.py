"""Sweeps without a search: jobs are finished by writing what a finished run leaves."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from tacevo.config.compose import compose, to_plain
from tacevo.config.tasks import facts_without_data, load_task
from tacevo.records import to_json
from tacevo.runs.progress import Progress
from tacevo.storage.ledger import Ledger
from tacevo.storage.sweep_directory import Job, SweepDirectory
from tacevo.sweeps.launch import Launcher

#: Shared by all jobs of the tests.
SHARED = ["experiment=demo", "tracking=none"]


def begin(directory: SweepDirectory, job: Job, shared: Sequence[str] = SHARED, *, finished: bool = True) -> None:
    """Write a run directory of a job, with a generation of its ledger."""
    run = directory.run(job)
    run.path.mkdir(parents=True, exist_ok=True)
    config = compose([*shared, *job.overrides])
    facts = replace(facts_without_data(config), counts=(config.data.images, 0, 0))
    with Ledger(run.ledger) as ledger:
        ledger.commit({"kind": "run", "job": job.name})
        ledger.commit({"kind": "generation", "generation": 0, "best": 0.25})
        digest = ledger.digest
    task = {"task": to_json(load_task(config, facts)), "data": to_json(facts)}
    run.write_json(
        "run.json", {"schema": 1, "config": to_plain(config), **task, "digest": digest if finished else None}
    )
    if finished:
        run.write_text("summary.md", "found")


@dataclass
class Launched:
    """A launcher that finishes jobs by itself, but for those that it is told to fail."""

    failing: tuple[str, ...] = ()
    #: Names of the jobs of each launch.
    calls: list[list[str]] = field(default_factory=list)
    launchers: list[Launcher] = field(default_factory=list)

    def __call__(
        self, directory: SweepDirectory, jobs: Sequence[Job], launcher: Launcher, look: Callable[[], None]
    ) -> None:
        """Finish or fail each job, and look on after each."""
        self.calls.append([job.name for job in jobs])
        self.launchers.append(launcher)
        for job in jobs:
            if job.name in self.failing:
                directory.fail(job, "the disk is full")
            else:
                begin(directory, job, directory.read()[0])
                directory.succeed(job)
            look()


class Heard(Progress):
    """A view that keeps what it is told."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []
        self.counts: list[tuple[int, int]] = []

    def say(self, text: str) -> None:
        """Keep a line."""
        self.lines.append(text)

    def advance(self, what: str, done: int, total: int, note: str = "") -> None:
        """Keep how many jobs are finished."""
        self.counts.append((done, total))


def files_of(folder: Path) -> dict[str, int]:
    """List the files below a folder, with the times of their last change in ns."""
    return {str(path.relative_to(folder)): path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}
