"""The commands of sweeps, `tacevo search -m` and `tacevo sweep status`."""

import argparse
from pathlib import Path

from tacevo.choices import Primary
from tacevo.cli.common import DIFFERENT, DONE, Parser
from tacevo.runs.progress import Progress
from tacevo.storage.sweep_directory import UNSTATED, SweepDirectory
from tacevo.sweeps.plan import sweep
from tacevo.sweeps.status import Standing, describe, status_of
from tacevo.sweeps.terms import Asked, describe_terms, read_varied

_EPILOG = """\
examples:
  tacevo search -m experiment=demo ablation=none,fixed_temperature seed=0,1
  tacevo search -m experiment=demo ablation=none,stall_temperature 'seed=range(0,5)' hydra.launcher.n_jobs=4
  tacevo search -m experiment=paper_force llm=anthropic ablation=none,no_qd seed=0,1,2 hydra/launcher=submitit_slurm
  tacevo sweep status sweeps/NAME

The command that began a sweep continues it: finished jobs are not repeated, stopped ones are resumed, failed ones are
repeated. With more arms or seeds it adds jobs."""


def add_sweep(parser: Parser) -> None:
    """Describe `tacevo sweep`."""
    parser.description = "Sweeps are begun and continued by `tacevo search -m`."
    parser.epilog = _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    actions = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    status = actions.add_parser("status", help="list every job: finished, running, failed and why, stopped, not begun")
    status.add_argument("sweep", metavar="DIR", help="the directory of a sweep")
    status.set_defaults(command=_status)


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
        metavar="METRIC",
        help=f"of a sweep: what arms are compared by first: {', '.join(Primary)} (default: test_score, which `tacevo "
        "study sweep=DIR` gives; test_mse and test_accuracy name that of a task)",
    )
    search.add_argument(
        "--vary",
        metavar="KEYS",
        help="of a sweep: settings that are the seed of each job, as in data.split_seed,data.sensor_seed",
    )
    search.add_argument(
        "--plan", metavar="FILE", help="of a sweep: the plan.json of `tacevo plan sweep` that it follows"
    )


def says_terms(options: argparse.Namespace) -> bool:
    """Return whether the command line says anything of the terms of a sweep."""
    return any(said is not None for said in (options.reference, options.primary, options.vary, options.plan))


def run_sweep(options: argparse.Namespace) -> int:
    """Run the jobs of a sweep that are not finished; the status is 1 if one is not finished then."""
    asked = Asked(
        primary=options.primary,
        reference=options.reference,
        vary=None if options.vary is None else read_varied(options.vary),
        plan=None if options.plan is None else Path(options.plan),
    )
    with Progress() as view:
        swept = sweep(options.overrides, options.into, view, asked=asked)
    print(describe(swept.statuses))
    print(f"\nsweep: {swept.directory}")
    return DONE if all(status.standing is Standing.finished for status in swept.statuses) else DIFFERENT


def _status(options: argparse.Namespace) -> int:
    directory = SweepDirectory(Path(options.sweep))
    shared, jobs = directory.read()
    terms = directory.read_terms()
    print(f"sweep over {' '.join(shared) or 'the defaults'}: {describe([status_of(directory, job) for job in jobs])}")
    if terms != UNSTATED:
        print(f"\n{describe_terms(terms)}")
    return DONE
