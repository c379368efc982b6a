"""The command `tacevo search`: one search, its estimate, or a sweep of searches."""

import argparse
import os
import shutil
import sys
from pathlib import Path

from tacevo.choices import Tracking
from tacevo.cli.common import DONE, OVERRIDE, Parser
from tacevo.cli.sweep import add_multirun, run_sweep, says_terms
from tacevo.config.compose import compose
from tacevo.config.folder import groups
from tacevo.records import Mode
from tacevo.runs.estimate import describe
from tacevo.runs.progress import Progress
from tacevo.runs.providers import require_temperature
from tacevo.runs.session import search
from tacevo.tracking.entries import viewing


def add_search(parser: Parser) -> None:
    """Describe `tacevo search`, with the choices of every config group."""
    choices = groups()
    width = max(map(len, choices))
    lines = [f"  {name.ljust(width)}  {', '.join(names)}" for name, names in choices.items()]
    parser.description = (
        "Run a search. The same command continues a stopped run, and repeats a finished\none in seconds."
    )
    parser.epilog = "\n".join(["config groups and their choices:", *lines])
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.fromfile_prefix_chars = "@"
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", help=OVERRIDE)
    parser.add_argument("--estimate", action="store_true", help="print requests, tokens, cost and hours; send nothing")
    add_multirun(parser)
    parser.set_defaults(command=_search)


def _search(options: argparse.Namespace) -> int:
    if options.multirun and options.estimate:
        options.parser.error("--estimate is for one search, so it cannot be combined with -m")
    if options.multirun:
        return run_sweep(options)
    if options.into is not None:
        options.parser.error("--into names the directory of a sweep, so it needs -m; for one search, set run.dir=DIR")
    if says_terms(options):
        options.parser.error("--reference, --primary, --vary and --plan are terms of a sweep, so they need -m")
    config = compose(options.overrides)
    if options.estimate:
        print(describe(config))
        return DONE
    require_temperature([override for override in options.overrides if override.startswith("ablation=")], config)
    with Progress() as view:
        result = search(config, view)
    print(result.summary)
    if config.llm.mode is Mode.replay:
        print("every answer came from the store: this search made no call and cost nothing")
    tacevo, mlflow = _as_typed("tacevo"), _as_typed("mlflow")
    print(f"run: {result.directory}")
    print(f"look:   {tacevo} show {result.directory} {result.best}")
    print(f"verify: {tacevo} replay {result.directory}")
    if config.tracking.kind is Tracking.mlflow:
        print(f"MLflow: {viewing(config.tracking.uri, mlflow)}")
    print(f"digest: {result.digest}")
    return DONE


def _as_typed(command: str) -> str:
    """Spell a command of this environment so that the user's shell finds it, activated or not."""
    if shutil.which(command):
        return command
    return os.path.relpath(Path(sys.executable).parent / command)
