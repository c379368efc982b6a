"""Whether a sweep's jobs are what sweep.json says: compared with the configurations that their runs recorded.

What it promises: seed and hash of the configuration of every job are those of its run; no configuration is there twice;
runs of one arm differ in their seeds only, and those of two arms in more. What an arm is follows from the recorded
configurations (`analysis.tables.ablation.settings_table`); its name is a label.
"""

from collections.abc import Sequence

from tacevo.config.compose import from_plain, to_plain
from tacevo.config.identity import config_hash, decisive
from tacevo.config.recorded import read_run
from tacevo.errors import DivergenceError
from tacevo.records import Json
from tacevo.runs.publishable import published_config
from tacevo.storage.canonical import content_hash
from tacevo.storage.sweep_directory import Job, SweepDirectory


def check_jobs(directory: SweepDirectory) -> None:
    """Compare sweep.json with the runs of its jobs.

    Raises:
        DivergenceError: the first difference, with job, field and both values.
        RunError: a file is damaged.
    """
    _, jobs = directory.read()
    settings = []
    for job in jobs:
        config, _, _ = read_run(directory.run(job))
        for field, listed, recorded in (("seed", job.seed, config.seed), ("config", job.config, config_hash(config))):
            if listed != recorded:
                raise DivergenceError(
                    f"{directory.path / 'sweep.json'}, job {job.name}: field {field!r} is {listed!r}; its run has "
                    f"{recorded!r}"
                )
        told = decisive(from_plain(published_config(to_plain(config))))  # paths by their last part, as in a bundle
        settings.append(content_hash({**told, "config": {**told["config"], "seed": None}}))
    _check_different_jobs(jobs)
    _check_arms(jobs, settings)


def _check_different_jobs(jobs: Sequence[Job]) -> None:
    """Two jobs with one configuration are one job."""
    by_hash: dict[str, str] = {}
    for job in jobs:
        other = by_hash.setdefault(job.config, job.name)
        if other != job.name:
            raise DivergenceError(f"jobs {other} and {job.name} have one configuration; a sweep has each job once")


def _check_arms(jobs: Sequence[Job], settings: Sequence[Json]) -> None:
    """See that runs of one arm differ in their seeds only, and those of two arms in more."""
    by_arm: dict[str, Json] = {}
    by_settings: dict[Json, str] = {}
    for job, chosen in zip(jobs, settings, strict=True):
        if by_arm.setdefault(job.arm, chosen) != chosen:
            raise DivergenceError(f"runs of the arm {job.arm!r} differ in more than their seeds, job {job.name} too")
        other = by_settings.setdefault(chosen, job.arm)
        if other != job.arm:
            raise DivergenceError(
                f"the arms {other!r} and {job.arm!r} have runs of the same settings; an arm is there once"
            )
