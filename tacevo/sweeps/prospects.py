"""The limits of a sweep, known before it runs: arms that are equal by construction, seeds that are too few."""

from collections.abc import Mapping, Sequence

from tacevo.config.identity import twins, twins_of
from tacevo.config.schema import RunConfig
from tacevo.results.study_lines import fewest_seeds
from tacevo.results.sweep import ALPHA
from tacevo.storage.sweep_directory import Job
from tacevo.text import counted


def shortcomings(planned: Mapping[Job, RunConfig], jobs: Sequence[Job], reference: str | None) -> list[str]:
    """Say in a sentence each which arms cannot differ, and that there are too few seeds for any test.

    Args:
        planned: the jobs that were asked for now, with their configurations.
        jobs: these, and those that the sweep had before.
        reference: the arm that others are compared with; None where nothing is compared.
    """
    pairs = twins((job.arm, job.seed, config) for job, config in planned.items())
    told = [
        f"{one} and {other} will find equal networks: with prompts=uniform nothing is drawn by the record of prompts, "
        "which one of them lacks; prompts=curiosity uses it"
        for one, other in pairs
    ]
    untested = twins_of(reference, pairs)
    tested = dict.fromkeys(job.arm for job in jobs if job.arm not in untested)
    seeds = {arm: len({job.seed for job in jobs if job.arm == arm}) for arm in tested}
    others = len(seeds) - 1
    if reference in seeds and others and (least := min(seeds.values())) < (needed := fewest_seeds(ALPHA / others)):
        told.append(
            f"{counted(least, 'seed')} of an arm can show nothing: to test {counted(others, 'arm')} against "
            f"{reference} at {ALPHA} after Holm takes {needed} or more, as in 'seed=range(0,{needed})'"
        )
    return told
