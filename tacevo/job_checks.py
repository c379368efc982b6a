"""Whether a sweep's jobs are what sweep.json says: held against the configurations that their runs recorded.

What it promises: seed, hash of the configuration, arm and overrides of every job are those of its run. Under the
version of tacevo that made the runs, the overrides give the whole configuration. Under another one, defaults may have
changed: then held is what sets one job apart from another, and what the overrides name, or the files that they choose.
Where they choose a file that is not here, nothing can be composed, and that is told. Nothing of a stranger's list is
composed that could read more than the files of conf/.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import yaml

from tacevo.anonymity import published_config
from tacevo.composition import compose, from_plain, to_plain
from tacevo.confdir import conf_root, groups
from tacevo.config import RunConfig
from tacevo.errors import ConfigError, DivergenceError, RunError
from tacevo.nesting import leaves
from tacevo.records import Json
from tacevo.replaying import read_run
from tacevo.rundir import RunDirectory, versions
from tacevo.store import Field, content_hash, differences, shown, value_at
from tacevo.sweepdir import Job, SweepDirectory, name_arm
from tacevo.sweepstatus import config_hash, decisive

#: Groups of which everything counts, beside the identity of the run.
_PARTS = {"data", "task"}

#: Who answered where nobody was chosen, in versions whose every experiment had a default.
_MODEL = "llm=grammar"

#: A key of a setting, and the name of a file of conf/.
_KEY = re.compile(r"\w+(\.\w+)*")
_CHOICE = re.compile(r"[\w-]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Compared:
    """A job with what decides its results."""

    job: Job
    overrides: tuple[str, ...]
    #: As its run recorded it.
    recorded: Json
    #: As its overrides compose here; None where they choose what is not here.
    composed: Json | None
    #: Whether this version made the run.
    is_ours: bool


def check_jobs(directory: SweepDirectory) -> tuple[str, ...]:
    """Hold sweep.json against the runs of its jobs.

    Returns:
        What could not be compared, for a person; empty where everything was.

    Raises:
        DivergenceError: the first difference, with job, field and both values.
        RunError: a file is damaged, or an override is none that is read from a stranger.
    """
    shared, jobs = directory.read()
    place = directory.path / "sweep.json"
    for override in [*shared, *(override for job in jobs for override in job.overrides)]:
        _insist_on_plain(place, override)
    compared = []
    for job in jobs:
        config, _, _ = read_run(directory.run(job))
        _insist(place, job, "seed", job.seed, config.seed)
        _insist(place, job, "config", job.config, config_hash(config))
        _insist(place, job, "arm", job.arm, name_arm(job.overrides))
        found = _compared(directory.run(job), job, (*shared, *job.overrides), config)
        if found.composed is not None:
            _check_alone(found)
        compared.append(found)
    _insist_on_different_jobs(jobs)
    _insist_on_arms(compared)
    whole = [found for found in compared if found.composed is not None]
    for other in whole[1:]:
        _check_pair(whole[0], other)
    return _untold(compared)


def _insist_on_plain(place: object, override: str) -> None:
    """Refuse an override that could read more than files of conf/, e.g. a variable of the environment.

    Raises:
        RunError: it could.
    """
    key, _, value = override.partition("=")
    is_choice = key in groups()
    if not _KEY.fullmatch(key) or "$" in value or (is_choice and not _CHOICE.fullmatch(_bare(value))):
        expected = (
            f"{key}=NAME, a file in conf/{key}, or {key}.KEY=VALUE" if is_choice else "GROUP.KEY=VALUE without any $"
        )
        raise RunError(f"{place} has the override {override!r}, which is not read; expected {expected}")


def _bare(value: str) -> str:
    return value.strip("'\"")


def _compared(directory: RunDirectory, job: Job, overrides: tuple[str, ...], config: RunConfig) -> _Compared:
    with directory.believed():
        version = directory.read_run()["versions"]["tacevo"]
    return _Compared(
        job=job,
        overrides=overrides,
        recorded=_told(config),
        composed=None if _unknown(overrides) else _told(_composed(job, overrides)),
        is_ours=version == versions()["tacevo"],
    )


def _told(config: RunConfig) -> Json:
    """Give what decides a job's results as a bundle tells it: paths by their last part."""
    return decisive(from_plain(published_config(to_plain(config))))


def _composed(job: Job, overrides: Sequence[str]) -> RunConfig:
    try:
        return compose([_MODEL, *overrides])
    except ConfigError as error:
        raise DivergenceError(f"the overrides of job {job.name} give no configuration here: {error}") from error


def _unknown(overrides: Sequence[str]) -> list[str]:
    """List the overrides that choose a file which is not in this conf/."""
    known = groups()
    chosen = (override.partition("=") for override in overrides)
    return [f"{key}={value}" for key, _, value in chosen if key in known and _bare(value) not in known[key]]


def _check_alone(found: _Compared) -> None:
    """Hold a job's overrides against its run."""
    named = None if found.is_ours else [_field(key) for key in _named(found.overrides)]
    for field in differences(found.composed, found.recorded):
        if named is None or any(_overlap(field, name) for name in named):
            _insist_on_equal(found, field)


def _named(overrides: Sequence[str]) -> Iterator[str]:
    """List the keys of what overrides set: settings, whole groups, and all that an experiment or an arm sets."""
    known = groups()
    for override in overrides:
        key, _, value = override.partition("=")
        yield key
        if key == "search":
            yield "search.generations"  # which stands elsewhere in what decides
        if key in known:
            yield from _set_by(key, _bare(value))


def _set_by(group: str, choice: str) -> Iterator[str]:
    """List the keys of what a file of conf/ sets outside its own group."""
    text = (conf_root() / group / f"{choice}.yaml").read_text(encoding="utf-8")
    if "@package _global_" not in text:
        return
    settings = yaml.safe_load(text)
    for default in settings.pop("defaults", []):
        if isinstance(default, dict):  # another group's file, e.g. `override /task: force`
            yield from (name.rpartition("/")[2] for name in default)
        elif (conf_root() / group / f"{default}.yaml").is_file():  # also one that is no choice by itself
            yield from _set_by(group, default)
    yield from (name for name, _ in leaves(settings))


def _field(key: str) -> Field:
    """Say where what decides a job's results has a setting."""
    if key == "search.generations":
        return ("generations",)
    field = tuple(key.split("."))
    return field if field[0] in _PARTS else ("config", *field)


def _overlap(one: Field, other: Field) -> bool:
    """Say whether one of two fields is the other, or holds it."""
    shorter = min(len(one), len(other))
    return one[:shorter] == other[:shorter]


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


def _insist_on_arms(compared: Sequence[_Compared]) -> None:
    """See that runs of one arm differ in their seeds only, and those of two arms in more."""
    by_arm: dict[str, str] = {}
    by_settings: dict[str, str] = {}
    for found in compared:
        settings = content_hash({**found.recorded, "config": {**found.recorded["config"], "seed": None}})
        arm = found.job.arm
        if by_arm.setdefault(arm, settings) != settings:
            raise DivergenceError(f"runs of the arm {arm!r} differ in more than their seeds, job {found.job.name} too")
        other = by_settings.setdefault(settings, arm)
        if other != arm:
            raise DivergenceError(
                f"the arms {other!r} and {arm!r} have runs of the same settings; an arm is there once"
            )


def _untold(compared: Sequence[_Compared]) -> tuple[str, ...]:
    """Say of which jobs the settings could not be composed, and why."""
    missed = [found for found in compared if found.composed is None]
    if not missed:
        return ()
    choices = dict.fromkeys(choice for found in missed for choice in _unknown(found.overrides))
    names = ", ".join(found.job.name for found in missed)
    return (
        f"NOT compared: whether the runs of jobs {names} have the settings that sweep.json claims, because it chooses "
        f"{', '.join(choices)}, which is not in this version's conf/; their seeds, hashes and names are right, and "
        "each arm has settings of its own",
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
