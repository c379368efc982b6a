"""A sweep's folder: what was asked for, and a run directory for each of its jobs.

sweep.json            the overrides that all jobs share, and the jobs
NAME/                 the run directory of a job (tacevo.storage.run_directory)
failed/NAME.json      why a job came to nothing, until it is given again and succeeds
launch/               what launching leaves behind: the last output of each job (NAME.log) and of the launcher
                      (launcher.log), and Hydra's own files
"""

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from tacevo.errors import RunError
from tacevo.records import Json
from tacevo.storage.canonical import content_hash, readable
from tacevo.storage.files import locked, sweep, write_durably
from tacevo.storage.run_directory import RunDirectory

#: Layout of sweep.json.
SCHEMA = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One run of a sweep."""

    #: Of its folder.
    name: str
    #: What is compared: the ablation, or the swept overrides without the seed.
    arm: str
    seed: int
    #: Those that this job does not share with all others.
    overrides: tuple[str, ...]
    #: Hash of what decides its results: two jobs with one hash are one job.
    config: str


class SweepDirectory:
    """Writes and reads the files of one sweep.

    Args:
        path: the folder; made when something is written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def is_one(self) -> bool:
        """Whether a sweep has been begun here."""
        return (self.path / "sweep.json").exists()

    @property
    def launch(self) -> Path:
        """Where launching leaves its files."""
        return self.path / "launch"

    @property
    def halt(self) -> Path:
        """The file that asks all jobs to stop, as long as it is there."""
        return self.launch / "halt"

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the sweep for this process alone.

        Raises:
            RunError: another process is at work in it, or the folder cannot be made.
        """
        with locked(self.path, "--into"):
            yield

    def log(self, name: str) -> Path:
        """Name the file that holds the last output of a job."""
        return self.launch / f"{name}.log"

    def run(self, job: Job) -> RunDirectory:
        """Give the run directory of a job, begun or not."""
        return RunDirectory(self.path / job.name)

    def write(self, overrides: Sequence[str], jobs: Sequence[Job]) -> None:
        """Write sweep.json whole."""
        sweep(self.path)
        write_durably(self.path / "sweep.json", sweep_text(overrides, jobs))

    def read(self) -> tuple[tuple[str, ...], tuple[Job, ...]]:
        """Read the shared overrides and the jobs.

        Raises:
            RunError: sweep.json is missing, damaged or of another layout, or names a job outside its folder.
        """
        path = self.path / "sweep.json"
        try:
            value = json.loads(path.read_text(encoding="utf-8"))
            schema = value["schema"]
            if schema != SCHEMA:
                raise RunError(f"{path} has schema {schema!r}; this version reads {SCHEMA}")
            jobs = tuple(_job(entry) for entry in value["jobs"])
            return _texts(value["overrides"]), jobs
        except FileNotFoundError as error:
            raise RunError(f"{self.path} is not the folder of a sweep: it has no sweep.json") from error
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise RunError(
                f"{path} is damaged: {type(error).__name__}: {error}; restore it, or delete it, and the "
                "`tacevo search -m` command that began the sweep writes it anew"
            ) from error

    def fail(self, job: Job, reason: str) -> None:
        """Keep why a job came to nothing."""
        path = self.path / "failed" / f"{job.name}.json"
        write_durably(path, readable({"job": job.name, "reason": reason}))

    def succeed(self, job: Job) -> None:
        """Forget the reason of an earlier failure."""
        (self.path / "failed" / f"{job.name}.json").unlink(missing_ok=True)

    def failure(self, job: Job) -> str | None:
        """Read why a job came to nothing when it was last given; None where it did not fail."""
        path = self.path / "failed" / f"{job.name}.json"
        try:
            return str(json.loads(path.read_text(encoding="utf-8"))["reason"])
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            return f"{path} is damaged: {error}"

    def endings(self, job: Job) -> tuple[int, ...]:
        """Tell apart the ends of a job: when it last finished and last failed, in ns; 0 for never."""
        files = (self.path / job.name / "summary.md", self.path / "failed" / f"{job.name}.json")
        return tuple(path.stat().st_mtime_ns if path.exists() else 0 for path in files)


def name_arm(own: Sequence[str]) -> str:
    """Name what a job compares: its ablation, and what else is varied but the seed."""
    given = dict(override.split("=", 1) for override in own)
    given.pop("seed", None)
    ablation = given.pop("ablation", None)
    parts = [*([ablation] if ablation else []), *(f"{key}={value}" for key, value in given.items())]
    return " ".join(parts) or "none"


def sweep_digest(digests: Mapping[str, str]) -> str:
    """Give the digest of a sweep from those of its runs, by the names of their jobs: 64 hex digits."""
    return content_hash(dict(digests))


def sweep_text(overrides: Sequence[str], jobs: Sequence[Job]) -> str:
    """Give what sweep.json holds."""
    return readable({"schema": SCHEMA, "overrides": list(overrides), "jobs": [asdict(job) for job in jobs]})


def _job(entry: Mapping[str, Json]) -> Job:
    """Read one job; its name must be that of a folder in the sweep's own."""
    name, seed = entry["name"], entry["seed"]
    if not isinstance(name, str) or Path(name).name != name or name in {"", ".", "..", "failed", "launch"}:
        raise ValueError(f"a job's name must be that of a folder; got {name!r}")
    if type(seed) is not int:  # true is an int to Python, and no seed
        raise ValueError(f"the seed of job {name} must be an integer; got {seed!r}")
    for key in ("arm", "config"):
        if not isinstance(entry[key], str):
            raise ValueError(f"{key!r} of job {name} must be a text; got {entry[key]!r}")
    job = Job(name=name, arm=entry["arm"], seed=seed, overrides=_texts(entry["overrides"]), config=entry["config"])
    if strange := entry.keys() - asdict(job).keys():
        raise ValueError(f"job {name} has the field {min(strange)!r}, which no job has")
    return job


def _texts(overrides: Json) -> tuple[str, ...]:
    if not isinstance(overrides, list) or not all(isinstance(override, str) for override in overrides):
        raise ValueError(f"'overrides' must be a list of texts; got {overrides!r}")
    return tuple(overrides)
