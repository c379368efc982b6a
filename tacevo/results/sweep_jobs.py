"""Compare sweep.json with the configurations that the runs of its jobs recorded.

What it promises: seed and hash of the configuration of every job are those of its run; each configuration is there
once; runs of one arm differ in their seeds only, and in what their sweep takes from these, and those of two arms in
more. What an arm is follows from the recorded configurations (`analysis.tables.ablation.settings_table`); its name is a
label.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from tacevo.choices import Varied
from tacevo.config.identity import config_hash, decisive
from tacevo.config.plain import from_plain
from tacevo.config.schema import RunConfig
from tacevo.errors import DivergenceError
from tacevo.records import Json, to_json
from tacevo.results.publishable import published_config
from tacevo.results.settings import settings_of
from tacevo.storage.canonical import content_hash, differences, shown
from tacevo.storage.sweep_directory import Job, SweepDirectory
from tacevo.text import listed

#: How many settings that differ a message names.
_SHOWN = 6


def check_jobs(directory: SweepDirectory) -> None:
    """Compare sweep.json with the runs of its jobs.

    Raises:
        DivergenceError: the first difference, with job, field and both values.
        RunError: a file is damaged.
    """
    sweep = directory.read()
    jobs, vary = sweep.jobs, sweep.terms.vary
    settings = []
    for job in jobs:
        config = settings_of(directory.run(job))
        for field, stated, recorded in (("seed", job.seed, config.seed), ("config", job.config, config_hash(config))):
            if stated != recorded:
                raise DivergenceError(
                    repr(stated),
                    place=f"{directory.path / 'sweep.json'}, job {job.name}, {field}",
                    expected=f"{recorded!r}, as in its run",
                )
        if varied(config, vary, job.seed) != config:
            raise DivergenceError(
                f"{', '.join(vary)}, which its run did not take from its seed",
                place=f"{directory.path / 'sweep.json'}, terms.vary, job {job.name}",
                expected=f"settings that are {job.seed} in its run, the seed of the job",
            )
        published = from_plain(published_config(to_json(config)))  # paths by their last part
        settings.append(decisive(replace(varied(published, vary, 0), seed=0)))
    _check_different_jobs(jobs)
    _check_arms(jobs, settings)


def _check_different_jobs(jobs: Sequence[Job]) -> None:
    """Check that each job has a configuration of its own."""
    by_hash: dict[str, str] = {}
    for job in jobs:
        other = by_hash.setdefault(job.config, job.name)
        if other != job.name:
            got = f"the same one, of hash {job.config[:12]}"
            raise DivergenceError(got, place=f"jobs {other} and {job.name}", expected="different configurations")


def _check_arms(jobs: Sequence[Job], settings: Sequence[Json]) -> None:
    """Check that runs of one arm differ in their seeds only, and those of two arms in more."""
    by_arm: dict[str, Json] = {}
    by_settings: dict[str, str] = {}
    for job, chosen in zip(jobs, settings, strict=True):
        if fields := differences(by_arm.setdefault(job.arm, chosen), chosen):
            raise DivergenceError(
                f"other values of {listed(map(shown, fields), most=_SHOWN)}",
                place=f"job {job.name}",
                expected=f"the settings of arm {job.arm!r}, except for the seed",
            )
        other = by_settings.setdefault(content_hash(chosen), job.arm)
        if other != job.arm:
            raise DivergenceError(
                "the same, apart from the seed", place=f"arms {other!r} and {job.arm!r}", expected="different settings"
            )


def varied(config: RunConfig, vary: Iterable[Varied], seed: int) -> RunConfig:
    """Return a configuration in which the varied settings are a seed."""
    settings: dict[str, Any] = {key.removeprefix("data."): seed for key in vary}
    return replace(config, data=replace(config.data, **settings))
