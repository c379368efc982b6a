"""Compare sweep.json with the configurations that the runs of its jobs recorded.

What it promises: seed and hash of the configuration of every job are those of its run; each configuration is there
once; runs of one arm differ in their seeds only, and in what their sweep takes from these, and those of two arms in
more. What an arm is follows from the recorded configurations (`analysis.tables.ablation.settings_table`); its name is a
label.
"""

from collections.abc import Iterable
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

#: The most settings that a message names.
_SHOWN = 6


def misfit(job: Job, config: RunConfig) -> tuple[str, int | str, int | str] | None:
    """Compare a job of sweep.json with the configuration of its run.

    Returns:
        The first of `seed` and `config`, the hash of the configuration, in which they differ, with its value in
        sweep.json and in the run; None where they agree.
    """
    values = (("seed", job.seed, config.seed), ("config", job.config, config_hash(config)))
    return next(((name, stated, recorded) for name, stated, recorded in values if stated != recorded), None)


def check_jobs(directory: SweepDirectory) -> None:
    """Compare sweep.json with the runs of its jobs, one job after the other.

    Raises:
        DivergenceError: the first difference, with job, field and both values.
        RunError: a file is damaged.
    """
    sweep, file = directory.read(), directory.path / "sweep.json"
    jobs_by_hash: dict[str, str] = {}
    settings_by_arm: dict[str, Json] = {}
    arms_by_settings: dict[str, str] = {}
    for job in sweep.jobs:
        config = settings_of(directory.run(job))
        if differing := misfit(job, config):
            field, stated, recorded = differing
            expected = f"{recorded!r}, as in its run"
            raise DivergenceError(repr(stated), place=f"{file}, job {job.name}, {field}", expected=expected)
        if varied(config, sweep.terms.vary, job.seed) != config:
            raise DivergenceError(
                f"{', '.join(sweep.terms.vary)}, which its run did not take from its seed",
                place=f"{file}, terms.vary, job {job.name}",
                expected=f"settings that are {job.seed} in its run, the seed of the job",
            )
        if (other := jobs_by_hash.setdefault(job.config, job.name)) != job.name:
            got = f"the same one, of hash {job.config[:12]}"
            raise DivergenceError(got, place=f"jobs {other} and {job.name}", expected="different configurations")
        published = from_plain(published_config(to_json(config)))  # paths by their last part
        settings = decisive(replace(varied(published, sweep.terms.vary, 0), seed=0))
        if fields := differences(settings_by_arm.setdefault(job.arm, settings), settings):
            raise DivergenceError(
                f"other values of {listed(map(shown, fields), most=_SHOWN)}",
                place=f"job {job.name}",
                expected=f"the settings of arm {job.arm!r}, except for the seed",
            )
        if (other := arms_by_settings.setdefault(content_hash(settings), job.arm)) != job.arm:
            arms = f"arms {other!r} and {job.arm!r}"
            raise DivergenceError("the same, apart from the seed", place=arms, expected="different settings")


def varied(config: RunConfig, vary: Iterable[Varied], seed: int) -> RunConfig:
    """Return a configuration in which the varied settings are a seed."""
    settings: dict[str, Any] = {key.removeprefix("data."): seed for key in vary}
    return replace(config, data=replace(config.data, **settings))
