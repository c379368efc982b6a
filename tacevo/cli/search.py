"""The command `tacevo search`, of one search or a sweep of them."""

import argparse
import shlex
from collections.abc import Iterable
from dataclasses import asdict
from functools import partial
from pathlib import Path

import yaml

from tacevo.choices import Primary
from tacevo.cli.common import DIFFERENT, DONE, OVERRIDE, Parser, add_config_dir, tell
from tacevo.config.chosen import part_of
from tacevo.config.comments import comments
from tacevo.config.compose import compose, compose_estimate
from tacevo.config.conf_folder import check_experiment, groups
from tacevo.config.schema import RunConfig
from tacevo.environment import as_typed
from tacevo.parts.kinds import TRACKERS
from tacevo.parts.tracker import Tracker
from tacevo.records import Mode, to_json
from tacevo.results.sweep import Standing
from tacevo.runs.progress import Progress
from tacevo.runs.providers import check_temperature
from tacevo.runs.session import Result, search
from tacevo.storage.canonical import canonical, leaves
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.sweeps.status import describe_jobs
from tacevo.sweeps.sweeping import plan_unasked, sweep
from tacevo.sweeps.terms import Asked, read_varied
from tacevo.text import as_override

#: Where the words stand beside the settings, in characters.
_WORDS = 42


def add_search(parser: Parser) -> None:
    """Describe `tacevo search`."""
    parser.description = (
        "Run a search. The same command continues a stopped run, and repeats a finished\none in seconds."
    )
    parser.write_epilog = _describe_settings
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.fromfile_prefix_chars = "@"
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", help=OVERRIDE)
    parser.add_argument("--estimate", action="store_true", help="print requests, tokens, cost and hours; send nothing")
    parser.add_argument("-c", "--cfg", choices=["job"], help="print the composed settings as YAML, and run nothing")
    parser.add_argument("--resolve", action="store_true", help="the same as --cfg job, for who knows Hydra")
    whats = ["all", "config", "defaults", "defaults-tree", "plugins", "searchpath"]  # Hydra's
    parser.add_argument("--info", nargs="?", const="all", choices=whats, metavar="WHAT", help="this, too")
    add_config_dir(parser)
    add_multirun(parser)
    parser.set_defaults(command=_search)


def _describe_settings() -> str:
    """List the choices of every config group, and every setting as it is where no group and no setting is given."""
    choices = groups()
    width = max(map(len, choices))
    defaults = [
        (key, value if isinstance(value, str) else canonical(value))
        for key, value in leaves(asdict(compose([])))
        if key not in {"parts", "code"}  # of parts of a user's own, which nobody has by default
    ]
    words = comments()
    return "\n".join(
        [
            "config groups and their choices:",
            *(f"  {name.ljust(width)}  {', '.join(names)}" for name, names in choices.items()),
            "",
            "settings, with their defaults (choices may change them):",
            *(
                f"  {f'{key}={value}'.ljust(_WORDS)}  {words[key].partition('. ')[0].rstrip('.')}"
                for key, value in defaults
            ),
        ]
    )


def _search(options: argparse.Namespace) -> int:
    if options.cfg or options.resolve or options.info:
        tell(yaml.safe_dump(to_json(compose(options.overrides)), sort_keys=False), end="")
        return DONE
    if options.into is not None and not options.multirun:
        options.parser.error("--into names the directory of a sweep, so it needs -m; for one search, set run.dir=DIR")
    if says_terms(options) and not options.multirun:
        options.parser.error("--reference, --primary, --vary and --plan are terms of a sweep, so they need -m")
    if options.estimate:
        return _estimate(options)
    if options.multirun:
        check_experiment(options.overrides)
        return run_sweep(options)
    config = compose(options.overrides)
    check_experiment(options.overrides)
    check_temperature([override for override in options.overrides if override.startswith("ablation=")], config)
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


def _estimate(options: argparse.Namespace) -> int:
    """Estimate a search, its cost before its hours, which take a measurement; or every job of a sweep."""
    from tacevo.runs.estimate import MEASURING, describe_cost, describe_estimates, describe_time

    if options.multirun:
        jobs = [(job.name, one) for job, one in plan_unasked(options.overrides, _asked(options).vary or ()).items()]
        later = partial(describe_estimates, jobs)
    else:
        jobs = [("", config := compose_estimate(options.overrides))]
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
    tell(f"read:   {result.directory / 'summary.md'}")
    tell(f"look:   {tacevo} show {run} {result.best}")
    tell(f"verify: {tacevo} replay {run}")
    for remark in remarks:
        tell(remark)
    if result.succeeded and not result.looked_up:
        tell(f"next:   {tacevo} noise {run} elites=2 seeds=12")  # the demo's sizes, see docs/log.md
    tell(f"digest: {result.digest}")


def add_multirun(search: argparse.ArgumentParser) -> None:
    """Describe the options of `tacevo search` for a sweep."""
    search.add_argument(
        "-m",
        "--multirun",
        action="store_true",
        help="run all combinations of overrides with several values, as in seed=0,1,2; hydra.launcher.n_jobs=N sets "
        "how many at once, hydra/launcher=submitit_slurm submits them to Slurm",
    )
    search.add_argument(
        "--into",
        metavar="DIR",
        help="the directory of the sweep (default: one in sweeps/, named after what its jobs share)",
    )
    search.add_argument(
        "--reference",
        metavar="ARM",
        help="of a sweep: the arm that others are compared with (default: none, if it is one)",
    )
    search.add_argument(
        "--primary",
        choices=[metric.value for metric in Primary],
        metavar="METRIC",
        help=f"of a sweep: what arms are compared by first: {', '.join(Primary)} (default: test_score, which `tacevo "
        "study sweep=DIR` gives; new_quartile with data=table)",
    )
    search.add_argument(
        "--vary",
        metavar="KEYS",
        help="of a sweep: settings that take each job's seed as their value, as in data.split_seed,data.sensor_seed",
    )
    search.add_argument(
        "--plan", metavar="FILE", help="of a sweep: the plan.json of `tacevo plan sweep` that it follows"
    )


def says_terms(options: argparse.Namespace) -> bool:
    """Return whether the command line says anything of the terms of a sweep."""
    return any(said is not None for said in (options.reference, options.primary, options.vary, options.plan))


def _asked(options: argparse.Namespace) -> Asked:
    """Read what the command line says of the terms of a sweep."""
    return Asked(
        primary=None if options.primary is None else Primary(options.primary),
        reference=options.reference,
        vary=None if options.vary is None else read_varied(options.vary),
        plan=None if options.plan is None else Path(options.plan),
    )


def run_sweep(options: argparse.Namespace) -> int:
    """Run the jobs of a sweep that are not finished; the status is 1 if one is not finished then."""
    with Progress() as view:
        directory, statuses = sweep(options.overrides, options.into, view, asked=_asked(options))
    tell(describe_jobs(statuses))
    tell(f"\nsweep: {directory}")
    is_finished = all(status.standing is Standing.finished for status in statuses)
    tell(f"next:  {_after(directory) if is_finished else 'the same command, which runs what is not finished'}")
    return DONE if is_finished else DIFFERENT


def _after(sweep: Path) -> str:
    """Return the command that a finished sweep is for: the tests of its networks, or else the comparison."""
    terms = SweepDirectory(sweep).read().terms
    if terms.primary is not None and terms.primary.is_tested and terms.retraining is None:
        return f"{as_typed('tacevo')} study {shlex.quote(as_override('sweep', str(sweep)))} seeds=5"
    return f"{as_typed('tacevo')} ablations {shlex.quote(str(sweep))}"
