"""Whether a sweep's jobs are what sweep.json says: held against the configurations that their runs recorded.

What it promises: seed, hash of the configuration, arm and overrides of every job are those of its run. What sets one
job apart from another must be what their overrides give under this version's conf/; what all of them share may have
other defaults by now, and is held against the overrides only where these name it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from tacevo.composition import compose
from tacevo.config import RunConfig
from tacevo.errors import ConfigError, DivergenceError
from tacevo.records import Json
from tacevo.replaying import read_run
from tacevo.store import Field, differences, shown, value_at
from tacevo.sweepdir import Job, SweepDirectory, name_arm
from tacevo.sweepstatus import config_hash, decisive

#: Groups of which everything counts, beside the identity of the run.
_PARTS = {"data", "task"}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Compared:
    """A job with what decides its results."""

    job: Job
    #: As its run recorded it.
    recorded: Json
    #: As its overrides compose here.
    composed: Json


def check_jobs(directory: SweepDirectory) -> None:
    """Hold sweep.json against the runs of its jobs.

    Raises:
        DivergenceError: the first difference, with job, field and both values.
        RunError: a file is damaged.
    """
    shared, jobs = directory.read()
    place = directory.path / "sweep.json"
    compared = []
    for job in jobs:
        config, _, _ = read_run(directory.run(job))
        _insist(place, job, "seed", job.seed, config.seed)
        _insist(place, job, "config", job.config, config_hash(config))
        _insist(place, job, "arm", job.arm, name_arm(job.overrides))
        overrides = [*shared, *job.overrides]
        found = _Compared(job=job, recorded=decisive(config), composed=decisive(_composed(job, overrides)))
        for field in _named(overrides, found.recorded):
            _insist_on_equal(found, field)
        compared.append(found)
    _insist_on_different_jobs(jobs)
    for other in compared[1:]:
        _check_pair(compared[0], other)


def _composed(job: Job, overrides: Sequence[str]) -> RunConfig:
    try:
        return compose(overrides)
    except ConfigError as error:
        raise DivergenceError(f"the overrides of job {job.name} give no configuration here: {error}") from error


def _named(overrides: Sequence[str], value: Json) -> list[Field]:
    """List the settings, among those that decide results, that overrides name."""
    written = [tuple(override.partition("=")[0].split(".")) for override in overrides]
    fields: list[Field] = [
        ("generations",) if key == ("search", "generations") else key if key[0] in _PARTS else ("config", *key)
        for key in written
    ]
    return [field for field in fields if _is_setting(value, field)]


def _is_setting(value: Json, field: Field) -> bool:
    for name in field:
        if not isinstance(value, dict) or name not in value:
            return False
        value = value[name]
    return not isinstance(value, dict)


def _check_pair(one: _Compared, other: _Compared) -> None:
    """See that what sets two jobs apart is what their overrides give."""
    for field in differences(one.composed, other.composed) + differences(one.recorded, other.recorded):
        _insist_on_equal(one, field)
        _insist_on_equal(other, field)


def _insist_on_equal(found: _Compared, field: Field) -> None:
    given, recorded = value_at(found.composed, field), value_at(found.recorded, field)
    if given != recorded:
        raise DivergenceError(
            f"job {found.job.name}: its overrides give {shown(field)}={given}, and its run has {recorded}: it is the "
            "run of another job"
        )


def _insist_on_different_jobs(jobs: Sequence[Job]) -> None:
    """Two jobs with one configuration are one job."""
    by_hash: dict[str, str] = {}
    for job in jobs:
        other = by_hash.setdefault(job.config, job.name)
        if other != job.name:
            raise DivergenceError(f"jobs {other} and {job.name} have one configuration; a sweep has each job once")


def _insist(place: object, job: Job, field: str, listed: Json, recorded: Json) -> None:
    if listed != recorded:
        raise DivergenceError(
            f"{place}, job {job.name}: field {field!r} is {listed!r}, and by its run and overrides {recorded!r}"
        )
