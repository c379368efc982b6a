"""The command `tacevo search`, of one search or a sweep of them."""

import shlex
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

import yaml

from tacevo.choices import Primary
from tacevo.cli.common import DIFFERENT, DONE, comparison, tell
from tacevo.config.chosen import part_of
from tacevo.config.compose import compose, compose_estimate
from tacevo.config.conf_folder import check_experiment
from tacevo.config.schema import RunConfig
from tacevo.environment import as_typed
from tacevo.parts.kinds import TRACKERS
from tacevo.parts.registry import is_there
from tacevo.parts.tracker import Tracker
from tacevo.records import Mode, to_json
from tacevo.results.sweep import Standing
from tacevo.runs.progress import Progress
from tacevo.runs.providers import check_temperature
from tacevo.runs.session import Result, search
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.sweeps.status import describe_jobs
from tacevo.sweeps.sweeping import plan_unasked, sweep
from tacevo.sweeps.terms import Asked, read_varied
from tacevo.text import as_override


def show_settings(overrides: Sequence[str]) -> int:
    """Print the composed settings as YAML."""
    tell(yaml.safe_dump(to_json(compose(overrides)), sort_keys=False), end="")
    return DONE


def run_one(overrides: Sequence[str]) -> int:
    """Run one search."""
    config = compose(overrides)
    check_experiment(overrides)
    check_temperature([override for override in overrides if override.startswith("ablation=")], config)
    return run_search(config)


def run_search(config: RunConfig) -> int:
    """Run a search, and print what it found; return the exit status."""
    with Progress() as view:
        result = search(config, view)
    told = []
    if config.llm.mode is Mode.replay:
        told.append("every answer came from the store: this search made no call and cost nothing")
    else:
        told += paid_now(result)
    tracker: Tracker = part_of(config, TRACKERS)
    if seen := tracker.viewing():
        told.append(seen)
    print_end(result, told)
    return DONE


def estimate(overrides: Sequence[str], asked: Asked | None) -> int:
    """Estimate a search, its cost before its hours, which take a measurement; or every job of a sweep of such terms."""
    from tacevo.runs.estimate import MEASURING, describe_cost, describe_estimates, describe_time

    if asked is not None:
        jobs = [(job.name, one) for job, one in plan_unasked(overrides, asked.vary or ()).items()]
        later = partial(describe_estimates, jobs)
    else:
        jobs = [("", config := compose_estimate(overrides))]
        tell(describe_cost(config), end="\n\n", flush=True)
        later = partial(describe_time, config)
    with Progress() as view:
        if any(not one.data.facts.is_looked_up for _, one in jobs):
            view.say(MEASURING)
        told = later()
    tell(told)
    return DONE


def paid_now(result: Result) -> list[str]:
    """Say what was asked and paid now; the cost in a summary is that of the record, whenever it was paid."""
    return [f"now:    {result.asked}"] if result.asked else []


def print_end(result: Result, remarks: Iterable[str] = ()) -> None:
    """Print on one screen what a search found, where all of it is to be seen, remarks, and what to do next."""
    tacevo, run = as_typed("tacevo"), shlex.quote(str(result.directory))
    tell(result.summary)
    tell(f"read:   {result.directory / 'summary.md'} (cite the digest of the search, below)")
    tell(f"look:   {tacevo} show {run} {result.best}")
    tell(f"verify: {tacevo} replay {run}")
    for remark in remarks:
        tell(remark)
    if result.succeeded and not result.looked_up and is_there("tacevo.studies.noise"):
        tell(f"next:   {tacevo} noise {run} elites=2 seeds=12")  # the demo's sizes, see docs/log.md
    tell(f"digest: {result.digest}")


def terms(*, primary: str | None, reference: str | None, vary: str | None, plan: str | None) -> Asked:
    """Read what the command line says of the terms of a sweep."""
    return Asked(
        primary=None if primary is None else Primary(primary),
        reference=reference,
        vary=None if vary is None else read_varied(vary),
        plan=None if plan is None else Path(plan),
    )


def run_sweep(overrides: Sequence[str], into: str | None, asked: Asked) -> int:
    """Run the jobs of a sweep that are not finished; the status is 1 if one is not finished then."""
    check_experiment(overrides)
    with Progress() as view:
        directory, statuses = sweep(overrides, into, view, asked=asked)
    tell(describe_jobs(statuses))
    tell(f"\nsweep: {directory}")
    is_finished = all(status.standing is Standing.finished for status in statuses)
    tell(f"next:  {_after(directory) if is_finished else 'the same command, which runs what is not finished'}")
    return DONE if is_finished else DIFFERENT


def _after(sweep: Path) -> str:
    """Return the command that a finished sweep is for: the tests of its networks, or else the comparison."""
    record = SweepDirectory(sweep).read()
    terms = record.terms
    if "experiment=pairs" in record.overrides and is_there("tacevo.cli.pairs"):
        return f"{as_typed('tacevo')} pairs {shlex.quote(str(sweep))}"
    if terms.primary is not None and terms.primary.is_tested and terms.retraining is None:
        return f"{as_typed('tacevo')} study {shlex.quote(as_override('sweep', str(sweep)))} seeds=5"
    return comparison(sweep)
