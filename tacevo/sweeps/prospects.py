"""What a sweep cannot show, known before it runs: arms that are equal by construction, seeds that are too few."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from tacevo.choices import PromptPolicy
from tacevo.config.checks import doubts_of_settings
from tacevo.config.identity import config_hash
from tacevo.config.schema import RunConfig
from tacevo.results.study_lines import fewest_seeds
from tacevo.results.sweep import ALPHA
from tacevo.storage.sweep_directory import Job
from tacevo.text import counted


def shortcomings(planned: Mapping[Job, RunConfig], jobs: Sequence[Job], reference: str | None) -> list[str]:
    """Say in a sentence each which arms cannot differ, or do not act, and that there are too few seeds for any test.

    Args:
        planned: the jobs that were asked for now, with their configurations.
        jobs: these, and those that the sweep had before.
        reference: the arm that others are compared with; None where nothing is compared.
    """
    told = [
        f"{one} and {other} will find equal networks: with prompts=uniform nothing is drawn by the record of prompts, "
        "which one of them lacks; prompts=curiosity uses it"
        for one, other in _twins(planned)
    ]
    arms = {job.arm: config for job, config in planned.items()}
    told += [f"{arm}: {doubt}" for arm, config in arms.items() for doubt in doubts_of_settings(config)]
    seeds = {arm: len({job.seed for job in jobs if job.arm == arm}) for arm in (job.arm for job in jobs)}
    others = len(seeds) - 1
    if reference in seeds and others and (least := min(seeds.values())) < (needed := fewest_seeds(ALPHA / others)):
        told.append(
            f"{counted(least, 'seed')} of an arm can show nothing: to test {counted(others, 'arm')} against "
            f"{reference} at {ALPHA} after Holm takes {needed} or more, as in 'seed=range(0,{needed})'"
        )
    return told


def _twins(planned: Mapping[Job, RunConfig]) -> Iterator[tuple[str, str]]:
    """Find arms whose jobs of every shared seed differ only in whether uniformly drawn prompts are recorded."""
    arms: dict[str, dict[int, RunConfig]] = {}
    for job, config in planned.items():
        arms.setdefault(job.arm, {})[job.seed] = config
    for (one, these), (other, those) in itertools.combinations(arms.items(), 2):
        shared = these.keys() & those.keys()
        if shared and all(_recording(these[seed]) == _recording(those[seed]) for seed in shared):
            yield one, other


def _recording(config: RunConfig) -> str:
    """Hash a configuration, as if it recorded prompts where it does not."""
    if config.prompts.policy is PromptPolicy.none:
        config = replace(config, prompts=replace(config.prompts, policy=PromptPolicy.uniform))
    return config_hash(config)
