"""Sweeps without a search: jobs are finished by writing what a finished run leaves."""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ledger_lines import ended, header, run_record
from smallest import DRAWN

from tacevo.config.compose import compose
from tacevo.config.schema import RunConfig
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.records import to_json
from tacevo.runs.progress import Progress
from tacevo.storage.ledger import sealed_text
from tacevo.storage.sweep_directory import Job, SweepDirectory, seeded
from tacevo.sweeps.launch import Launcher

#: Shared by all jobs of the tests.
SHARED = ["experiment=published_force", "tracking=none", "data.source=touches", *DRAWN]


@functools.cache
def composed(*overrides: str) -> RunConfig:
    """Compose once what several tests ask for."""
    return compose(overrides)


def begin(directory: SweepDirectory, job: Job, shared: Sequence[str] = SHARED, *, finished: bool = True) -> None:
    """Write a run directory of a job, with a generation of its ledger."""
    run = directory.run(job)
    run.path.mkdir(parents=True, exist_ok=True)
    vary = directory.read().terms.vary if directory.is_one else ()
    config = composed(*shared, *job.overrides, *seeded(vary, job.seed))
    facts = replace(facts_without_data(config), counts=(config.data.images or 0, 0, 0))
    text, digest = sealed_text([header(task=job.name), ended(0)])
    run.write_text("ledger.jsonl", text)
    described = {"config": to_json(config), "task": load_task(config, facts), "data": facts}
    run.write_run(run_record(**described, digest=digest if finished else None))
    if finished:
        run.write_text("summary.md", "found")


@dataclass
class Launched:
    """A launcher that finishes jobs by itself, except for those that are to fail."""

    failing: tuple[str, ...] = ()
    #: Names of the jobs of each launch.
    calls: list[list[str]] = field(default_factory=list)
    launchers: list[Launcher] = field(default_factory=list)

    def __call__(
        self, directory: SweepDirectory, jobs: Mapping[Job, RunConfig], launcher: Launcher, show: Callable[[Job], None]
    ) -> None:
        """Finish or fail each job, and show it."""
        self.calls.append([job.name for job in jobs])
        self.launchers.append(launcher)
        for job in jobs:
            if job.name in self.failing:
                directory.fail(job, "the disk is full")
            else:
                begin(directory, job, directory.read().overrides)
                directory.succeed(job)
            show(job)


class Heard(Progress):
    """A view that keeps what it is told."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []
        self.counts: list[tuple[int, int]] = []

    def say(self, text: str) -> None:
        """Keep a line."""
        self.lines.append(text)

    def advance(self, what: str, done: int, total: int, note: str = "", *, recalled: bool = False) -> None:
        """Keep how many jobs are finished."""
        self.counts.append((done, total))


def files_of(folder: Path) -> dict[str, int]:
    """List the files below a directory, with the times of their last change in ns."""
    return {str(path.relative_to(folder)): path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}
