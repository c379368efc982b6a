"""A sweep's directory: what was asked for, and a run directory for each of its jobs.

sweep.json            the overrides that all jobs share, the jobs, and the terms that they are compared on
NAME/                 the run directory of a job (tacevo.storage.run_directory)
failed/NAME.json      why a job failed, until it is repeated and succeeds
launch/               what launching leaves behind: the last output of each job (NAME.log), what a job on Slurm is
                      started by (NAME.json), and submitit's files
"""

import re
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Ge

from tacevo.choices import ChosenBy, Primary, Varied
from tacevo.errors import RunError, TacevoError
from tacevo.records import Record, written
from tacevo.storage.canonical import content_hash, readable
from tacevo.storage.files import locked, remove_leftovers, write_durably
from tacevo.storage.plan_file import SeedPlan
from tacevo.storage.run_directory import RunDirectory, name_instead
from tacevo.text import as_overrides
from tacevo.typed import FreeJson, parse

#: Names in a sweep's directory that are not jobs'.
_TAKEN = frozenset({"", ".", "..", "failed", "launch"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Job(Record):
    """One run of a sweep."""

    #: The name of the job's directory.
    name: str
    #: The arm that is compared: the ablation, or the swept overrides without the seed.
    arm: str
    seed: int
    #: The overrides that this job does not share with all others.
    overrides: tuple[str, ...]
    #: Hash of what decides its results: two jobs with one hash are one job.
    config: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Retraining(Record):
    """The terms on which the best networks of each job are trained again and tested."""

    #: The number of best networks, at most; with `validated`, of those among which one is chosen.
    elites: Annotated[int, Ge(1)] = 1
    #: K, fresh training seeds of each network.
    seeds: Annotated[int, Ge(1)]
    epochs: Annotated[int, Ge(1)]
    #: The quantity by which the best ones are chosen.
    choose: ChosenBy
    #: The arms whose jobs are tested, in the order of the sweep; () for all, also for those that are added later.
    arms: tuple[str, ...] = ()
    #: (name, value) of the settings of numerics and device that are not the jobs' own.
    other_device: tuple[tuple[str, FreeJson], ...] = ()

    @property
    def settings(self) -> str:
        """The settings of `tacevo study sweep=` that state it."""
        several = f"elites={self.elites} " if self.elites > 1 else ""
        arms = f" {shlex.quote('arms=' + ','.join(self.arms))}" if self.arms else ""
        other = "".join(f" {shlex.quote(word)}" for word in as_overrides(self.other_device))
        return f"{several}seeds={self.seeds} epochs={self.epochs} choose={self.choose}{arms}{other}"

    @property
    def tested(self) -> int:
        """The number of networks of each job that are tested."""
        return 1 if self.choose is ChosenBy.validated else self.elites

    def tests(self, arm: str) -> bool:
        """Return whether the jobs of an arm are tested."""
        return not self.arms or arm in self.arms


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepTerms(Record):
    """The terms on which the arms of a sweep are compared; those of an early sweep, which states none, are empty."""

    #: The first metric of comparison; None where it was not stated when the sweep began.
    primary: Primary | None = None
    #: The arm that all others are compared with; None for `none`, where there is such an arm.
    reference: str | None = None
    #: Settings that take each job's seed as their value.
    vary: tuple[Varied, ...] = ()
    #: The plan that the sweep follows; None where nothing was planned.
    plan: SeedPlan | None = None
    #: The terms on which the best networks are tested, written before the first of these trainings; None until then.
    retraining: Retraining | None = None


#: The terms of a sweep that states none.
UNSTATED = SweepTerms()


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepRecord(Record):
    """The content of sweep.json."""

    schema: Literal[1] = 1
    #: The overrides that all jobs share.
    overrides: tuple[str, ...]
    jobs: tuple[Job, ...]
    terms: SweepTerms = UNSTATED

    @property
    def text(self) -> str:
        """The file; terms that state nothing are left out, as they are from an early sweep."""
        return readable({"schema": self.schema, **written(self)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure(Record):
    """The failure of a job when it last ran: the content of failed/NAME.json."""

    job: str
    #: The reason in words.
    reason: str
    #: Whether the scheduler ended the job, or lost its node; otherwise its search failed, which is a result of its arm.
    by_scheduler: bool = False


class SweepDirectory:
    """Writes and reads the files of one sweep; the directory is made when something is written."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def is_one(self) -> bool:
        """Whether a sweep has been begun here."""
        return (self.path / "sweep.json").exists()

    @property
    def launch(self) -> Path:
        """The directory of what launching leaves behind."""
        return self.path / "launch"

    def locked(self) -> AbstractContextManager[None]:
        """Hold the sweep for this process alone (see `tacevo.storage.files.locked`)."""
        return locked(self.path, "--into")

    def log(self, job: Job) -> Path:
        """Return the file that holds the last output of a job."""
        return self.launch / f"{job.name}.log"

    def order(self, job: Job) -> Path:
        """Return the file that holds what a job on Slurm is started by."""
        return self.launch / f"{job.name}.json"

    def run(self, job: Job) -> RunDirectory:
        """Return the run directory of a job, begun or not."""
        return RunDirectory(self.path / job.name)

    def write(self, sweep: SweepRecord) -> None:
        """Write sweep.json whole."""
        remove_leftovers(self.path)
        write_durably(self.path / "sweep.json", sweep.text)

    def read(self) -> SweepRecord:
        """Read sweep.json.

        Raises:
            RunError: sweep.json is missing, damaged or of another layout, or names a job outside its directory.
        """
        path = self.path / "sweep.json"
        if not path.exists():
            is_run = (self.path / "run.json").exists()
            raise RunError(
                "a directory without sweep.json" if self.path.exists() else "a path that does not exist",
                place=str(self.path),
                expected="the directory of a sweep",
                remedy="this is a run, which the other commands take"
                if is_run
                else name_instead(self.path) or "`tacevo search -m` makes one",
            )
        remedy = "restore it, or delete it and repeat the `tacevo search -m` command that began the sweep"
        record = parse(SweepRecord, path.read_bytes(), place=str(path), error=RunError, remedy=remedy)
        for job in record.jobs:
            if Path(job.name).name != job.name or job.name in _TAKEN:
                raise RunError(repr(job.name), place=f"{path}, jobs", expected="the name of a directory", remedy=remedy)
        return record

    def fail(self, job: Job, reason: str, *, by_scheduler: bool = False) -> None:
        """Keep why a job failed."""
        failure = Failure(job=job.name, reason=reason, by_scheduler=by_scheduler)
        write_durably(self._failure(job), readable(asdict(failure)))

    def succeed(self, job: Job) -> None:
        """Forget the reason of an earlier failure."""
        self._failure(job).unlink(missing_ok=True)

    def failure(self, job: Job) -> Failure | None:
        """Read why a job failed when it last ran; None if it did not fail."""
        path = self._failure(job)
        if not path.exists():
            return None
        try:
            return parse(Failure, path.read_bytes(), place=str(path), error=RunError)
        except RunError as error:
            return Failure(job=job.name, reason=str(error))

    def _failure(self, job: Job) -> Path:
        return self.path / "failed" / f"{job.name}.json"


@contextmanager
def naming(job: str) -> Iterator[None]:
    """Let errors name the job that they are of."""
    try:
        yield
    except TacevoError as error:
        error.place = ", ".join(part for part in (f"job {job}", error.place) if part)
        raise


#: A character behind the backslash that Hydra writes before it in a text without quotes, such as a path with a colon.
_ESCAPED = re.compile(r"\\([\\()\[\]{}:=, \t])")


def name_arm(own: Sequence[str]) -> str:
    """Name what a job compares: its ablation, and what else is varied but the seed."""
    given = dict(override.split("=", 1) for override in own)
    given.pop("seed", None)
    ablation = given.pop("ablation", None)
    values = {key: _ESCAPED.sub(r"\1", value) for key, value in given.items()}
    parts = [*([ablation] if ablation else []), *(f"{key}={value}" for key, value in values.items())]
    return " ".join(parts) or "none"


def sweep_digest(digests: Mapping[str, str]) -> str:
    """Return the digest of a sweep from those of its runs, by the names of their jobs: 64 hex digits."""
    return content_hash(dict(digests))


def seeded(vary: Collection[Varied], seed: int) -> tuple[str, ...]:
    """Return the overrides of a job that follow from its seed."""
    return tuple(f"{key}={seed}" for key in vary)
