"""The `tacevo` command."""

import argparse
import contextlib
import os
import shutil
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType

from tacevo import __version__
from tacevo.cli.analysis import add_ablations, add_analysis
from tacevo.cli.cache import add_cache
from tacevo.cli.common import DIFFERENT, DONE, INTERRUPTED, MISTAKE, OVERRIDE, Parser
from tacevo.cli.data import add_data
from tacevo.cli.publish import add_publish
from tacevo.cli.reproduce import add_continue, add_replay
from tacevo.cli.study import add_study
from tacevo.cli.sweep import add_multirun, add_sweep, run_sweep
from tacevo.cli.track import add_track
from tacevo.errors import BundleError, DivergenceError, TacevoError
from tacevo.text import printable

_EPILOG = """\
examples:
  tacevo search experiment=demo               a small search, in minutes
  tacevo search experiment=demo seed=1        another one
  tacevo search -m experiment=demo ablation=none,fixed_temperature seed=0,1   a sweep of four
  tacevo replay runs/NAME                     run it again from its stores and compare
  tacevo replay runs/NAME --retrain 5         and train five of its candidates again, bit for bit
  tacevo replay runs/NAME --diff runs/OTHER   where two runs part, and how far they agree
  tacevo publish runs/NAME -o NAME.zip        one file with which anybody can replay it
  tacevo continue NAME.zip search.generations=30   take it up where it ended
  tacevo study run=runs/NAME                  its best networks and the baseline, trained fully with 20 seeds each
  tacevo show runs/NAME g02s03                one candidate, its numbers and its source
  tacevo data check task=grating              what a data set holds, and a contact sheet of it
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return its exit status."""
    options = _parsed(arguments)
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        command: Callable[[argparse.Namespace], int] = options.command
        return command(options)
    except KeyboardInterrupt:
        print(f"\ninterrupted; {options.interrupted}", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        with contextlib.suppress(OSError):
            sys.stdout.close()
        return DONE
    except (BundleError, DivergenceError) as error:
        print(
            f"{'refused' if isinstance(error, BundleError) else 'different'}: {printable(str(error))}", file=sys.stderr
        )
        return DIFFERENT
    except TacevoError as error:
        print(f"error: {printable(str(error))}", file=sys.stderr)
        return MISTAKE
    except OSError as error:  # a full disk, a folder without permission
        named = error.filename is not None and error.strerror is not None
        print(f"error: {f'{error.filename}: {error.strerror}' if named else error}", file=sys.stderr)
        return MISTAKE


def _parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line; overrides may stand behind options too, where argparse itself takes no more of them."""
    parser = _parser()
    try:
        options, rest = parser.parse_known_args(arguments)
    except UnicodeDecodeError:
        parser.error("a file of overrides (@FILE) must be text in UTF-8, with one override a line")
    strange = [word for word in rest if word.startswith("-") or "=" not in word]
    if strange or (rest and "overrides" not in options):
        options.parser.error(f"unrecognized arguments: {' '.join(strange or rest)}")
    if rest:
        options.overrides = [*options.overrides, *rest]
    return options


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Treat a polite request to end like Ctrl-C."""
    raise KeyboardInterrupt


def _parser() -> argparse.ArgumentParser:
    """Describe the command line; commands import what they need only when they run, so that help is quick."""
    parser = Parser(
        prog="tacevo",
        description="Architecture search for vision-based tactile sensors that can be replayed bit for bit.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"tacevo {__version__}")
    parser.set_defaults(interrupted="what was computed is kept, and the same command continues")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    search = commands.add_parser(
        "search",
        help="run a search, or continue one that was stopped",
        description="Run a search. The same command continues a stopped run, and repeats a finished one in seconds.",
        fromfile_prefix_chars="@",
    )
    search.add_argument("overrides", nargs="*", metavar="OVERRIDE", help=OVERRIDE)
    search.add_argument("--estimate", action="store_true", help="print requests, tokens and cost, and ask nobody")
    add_multirun(search)
    search.set_defaults(command=_search)

    add_replay(commands)
    add_publish(commands)
    add_continue(commands)
    add_sweep(commands)
    add_study(commands)
    add_analysis(commands)
    add_ablations(commands)

    show = commands.add_parser("show", help="what a run found, or one candidate of it")
    show.add_argument("run", metavar="RUN", help="the folder of a run")
    show.add_argument("candidate", metavar="CANDIDATE", nargs="?", help="its id, e.g. g02s03")
    show.set_defaults(command=_show)

    _add_check(commands)

    add_track(commands)
    add_data(commands)
    add_cache(commands)

    doctor = commands.add_parser("doctor", help="whether this machine has what a run needs")
    doctor.set_defaults(command=_doctor)
    return parser


def _add_check(commands: "argparse._SubParsersAction[Parser]") -> None:
    """Describe `tacevo check`."""
    check = commands.add_parser(
        "check",
        help="put raw answers of a model through the gate",
        description="Put raw answers through the gate: text files, or JSON recordings with a `response`.",
    )
    check.add_argument("files", nargs="+", metavar="FILE")
    check.add_argument("--task", default="force", metavar="NAME", help="whose contract to apply (default: force)")
    check.add_argument("--image-size", type=int, metavar="PIXELS", help="default: that of the task's data")
    check.add_argument("--json", action="store_true", help="one JSON object a line")
    check.set_defaults(command=_check)


def _search(options: argparse.Namespace) -> int:
    if options.multirun and options.estimate:
        options.parser.error("--estimate tells of one search, and so takes no -m")
    if options.multirun:
        return run_sweep(options)
    if options.into is not None:
        options.parser.error("--into names the folder of a sweep, and so needs -m; a search has run.dir=DIR")
    if options.estimate:
        return _estimate(options)
    from rich.console import Console

    from tacevo.config.compose import compose
    from tacevo.records import Mode
    from tacevo.runs.progress import make_view
    from tacevo.runs.providers import require_temperature
    from tacevo.runs.session import search
    from tacevo.tracking.entries import viewing

    config = compose(options.overrides)
    require_temperature([override for override in options.overrides if override.startswith("ablation=")], config)
    total = 1 + config.search.initial + config.search.generations * config.search.candidates
    with make_view(Console(stderr=True), total=total, generations=config.search.generations) as view:
        result = search(config, view)
    print(result.summary)
    if config.llm.mode is Mode.replay:
        print("every answer came from the store: this search made no call and cost nothing")
    tacevo, mlflow = _as_typed("tacevo"), _as_typed("mlflow")
    print(f"run: {result.directory}")
    print(f"look:   {tacevo} show {result.directory} {result.best}")
    print(f"verify: {tacevo} replay {result.directory}")
    if config.tracking.kind.value == "mlflow":
        print(f"MLflow: {viewing(config.tracking.uri, mlflow)}")
    print(f"digest: {result.digest}")
    return DONE


def _estimate(options: argparse.Namespace) -> int:
    from tacevo.config.compose import compose
    from tacevo.runs.estimate import describe

    print(describe(compose(options.overrides)))
    return DONE


def _as_typed(command: str) -> str:
    """Spell a command of this environment so that the user's shell finds it, activated or not."""
    if shutil.which(command):
        return command
    return os.path.relpath(Path(sys.executable).parent / command)


def _show(options: argparse.Namespace) -> int:
    from tacevo.cli.inspect import show_candidate, show_run

    path = Path(options.run)
    print(show_run(path) if options.candidate is None else show_candidate(path, options.candidate), end="")
    return DONE


def _check(options: argparse.Namespace) -> int:
    from tacevo.cli.inspect import check_files

    for line in check_files(options.files, task=options.task, image_size=options.image_size, as_json=options.json):
        print(line, flush=True)
    return DONE


def _doctor(options: argparse.Namespace) -> int:
    from tacevo.cli.inspect import examine

    findings, sound = examine()
    print(findings)
    return DONE if sound else DIFFERENT


if __name__ == "__main__":
    sys.exit(main())
