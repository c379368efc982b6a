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
from tacevo.errors import DivergenceError, TacevoError
from tacevo.store import KINDS

#: Exit status: done; a comparison or verification failed; the user's mistake; interrupted.
DONE, DIFFERENT, MISTAKE, INTERRUPTED = 0, 1, 2, 130

_EPILOG = """\
examples:
  tacevo search experiment=demo               a small search, in minutes
  tacevo search experiment=demo seed=1        another one
  tacevo replay runs/NAME                     run it again from its stores and compare
  tacevo show runs/NAME g02s03                one candidate, its numbers and its source
  tacevo data check task=grating              what a data set holds, and a contact sheet of it
"""

_DATA_EPILOG = """\
examples:
  tacevo data check task=force
  tacevo data check task=force data=tacverse data.root=FOLDER
  tacevo data show task=grating -o gratings.pdf
  tacevo data simulate task=force n=3000 out=simulated
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
    except DivergenceError as error:
        print(f"different: {error}", file=sys.stderr)
        return DIFFERENT
    except (TacevoError, OSError) as error:  # an OSError names the file: a full disk, a folder without permission
        print(f"error: {error}", file=sys.stderr)
        return MISTAKE


def _parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line; overrides may stand behind options too, where argparse itself takes no more of them."""
    parser = _parser()
    options, rest = parser.parse_known_args(arguments)
    strange = [word for word in rest if word.startswith("-") or "=" not in word]
    if strange or (rest and "overrides" not in options):
        parser.error(f"unrecognized arguments: {' '.join(strange or rest)}")
    if rest:
        options.overrides = [*options.overrides, *rest]
    return options


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Treat a polite request to end like Ctrl-C."""
    raise KeyboardInterrupt


_OVERRIDE = "GROUP=CHOICE or KEY=VALUE, as in Hydra, or @FILE with one of them a line"


class _Parser(argparse.ArgumentParser):
    """A parser whose `search` command lists the choices of every config group, read only when somebody asks.

    A file of overrides (`@FILE`) may have empty lines and comments.
    """

    def convert_arg_line_to_args(self, arg_line: str) -> list[str]:
        """Read one line of a file of overrides."""
        text = arg_line.strip()
        return [] if text.startswith("#") or not text else [text]

    def format_help(self) -> str:
        """Write the help."""
        text = super().format_help()
        if not self.prog.endswith(" search"):
            return text
        from tacevo.confdir import groups

        width = max(map(len, groups()))
        lines = [f"  {name.ljust(width)}  {', '.join(choices)}" for name, choices in groups().items()]
        return "\n".join([f"{text}\nconfig groups and their choices:", *lines, ""])


def _parser() -> argparse.ArgumentParser:
    """Describe the command line; commands import what they need only when they run, so that help is quick."""
    parser = _Parser(
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
    search.add_argument("overrides", nargs="*", metavar="OVERRIDE", help=_OVERRIDE)
    search.add_argument("--estimate", action="store_true", help="print requests, tokens and cost, and ask nobody")
    search.set_defaults(command=_search)

    replay = commands.add_parser(
        "replay",
        help="run a recorded search again from its stores and compare",
        description="Run a recorded search again, without model, training or data set, and compare every line.",
    )
    replay.add_argument("run", metavar="RUN", help="the folder of a run")
    replay.add_argument("--store", metavar="DIR", help="where its stores lie, if they were moved")
    replay.set_defaults(command=_replay)

    show = commands.add_parser("show", help="what a run found, or one candidate of it")
    show.add_argument("run", metavar="RUN", help="the folder of a run")
    show.add_argument("candidate", metavar="CANDIDATE", nargs="?", help="its id, e.g. g02s03")
    show.set_defaults(command=_show)

    _add_check(commands)

    track = commands.add_parser(
        "track",
        help="write a run's ledger into MLflow, or what is missing of it there",
        description="Mirror a run directory into MLflow. Doing it twice writes nothing twice.",
    )
    track.add_argument("run", metavar="RUN", help="the folder of a run")
    track.add_argument("--uri", help="MLflow tracking URI (default: the run's own)")
    track.set_defaults(command=_track)

    _add_data(commands)
    _add_cache(commands.add_parser("cache", help="look into the stores of answers, and move what a run needs"))

    doctor = commands.add_parser("doctor", help="whether this machine has what a run needs")
    doctor.set_defaults(command=_doctor)
    return parser


def _add_check(commands: "argparse._SubParsersAction[_Parser]") -> None:
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


def _add_data(commands: "argparse._SubParsersAction[_Parser]") -> None:
    """Describe `tacevo data` and its commands."""
    data = commands.add_parser(
        "data",
        help="look at a data set, or write a simulated one as files",
        description="Look at a data set before a search, or write a simulated one as files.",
        epilog=_DATA_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    data.set_defaults(interrupted="nothing half-made is left")
    choices = data.add_subparsers(title="commands", required=True, metavar="COMMAND")

    check = choices.add_parser(
        "check",
        help="load a data set as a search would, count it, and draw a contact sheet",
        description="Load a data set as a search would, count it, and draw a contact sheet. "
        "The exit status is 1 where equal images straddle the splits.",
        fromfile_prefix_chars="@",
    )
    check.add_argument("overrides", nargs="*", metavar="OVERRIDE", help=_OVERRIDE)
    check.add_argument("-o", "--output", metavar="FILE", help="the contact sheet: .png, .pdf or .svg")
    check.add_argument("--json", action="store_true", help="the findings as one JSON object")
    check.set_defaults(command=_data_check)

    show = choices.add_parser(
        "show",
        help="draw a few samples with their labels, for a paper",
        description="Draw a few samples with their labels: one of each class or level, or from the least to the most.",
        fromfile_prefix_chars="@",
    )
    show.add_argument("overrides", nargs="*", metavar="OVERRIDE", help=_OVERRIDE)
    show.add_argument("-o", "--output", metavar="FILE", required=True, help="the figure: .png, .pdf or .svg")
    show.add_argument("--width", choices=["single", "double"], default="double", help="columns of a paper")
    show.set_defaults(command=_data_show)

    simulate = choices.add_parser(
        "simulate",
        help="write a simulated data set as images and labels, in TacVerse's layout",
        description="Write a simulated data set as images and labels, in TacVerse's layout; the folder is whole or "
        "absent.",
        fromfile_prefix_chars="@",
    )
    settings = "out=FOLDER, n=IMAGES, or an override: " + _OVERRIDE
    simulate.add_argument("overrides", nargs="+", metavar="SETTING", help=settings)
    simulate.set_defaults(command=_data_simulate)


def _add_cache(cache: argparse.ArgumentParser) -> None:
    """Describe the commands on the stores."""
    actions = cache.add_subparsers(title="commands", required=True, metavar="COMMAND")

    ls = actions.add_parser("ls", help="count entries by kind and model, with sizes, tokens and costs")
    ls.add_argument("--kind", choices=KINDS, help="only these")
    ls.add_argument("--model", metavar="TEXT", help="only completions of models whose name contains TEXT")

    verify = actions.add_parser("verify", help="check every entry; status 1 where one is damaged")

    explain = actions.add_parser(
        "explain", help="what an entry is, or how a request differs from the nearest recording"
    )
    explain.add_argument("key", metavar="KEY", help="the first digits of a key, or a JSON file with a request")

    export = actions.add_parser("export", help="write exactly the entries that a run needs into one file")
    export.add_argument("run", metavar="RUN", help="the folder of a run")
    export.add_argument("-o", "--output", required=True, metavar="FILE")
    export.add_argument("--store", metavar="DIR", help="where its stores lie, if they were moved")
    export.set_defaults(command=_cache_export)

    import_ = actions.add_parser("import", help="verify such a file, then write its entries into the stores")
    import_.add_argument("file", metavar="FILE")

    commands = {ls: _cache_ls, verify: _cache_verify, explain: _cache_explain, import_: _cache_import}
    for parser, command in commands.items():
        parser.add_argument("--store", default="cache", metavar="DIR", help="the folder of the stores (default: cache)")
        parser.set_defaults(command=command)


def _search(options: argparse.Namespace) -> int:
    if options.estimate:
        return _estimate(options)
    from rich.console import Console

    from tacevo.composition import compose
    from tacevo.progress import make_view
    from tacevo.session import search
    from tacevo.tracking.entries import without_password

    config = compose(options.overrides)
    total = 1 + config.search.initial + config.search.generations * config.search.candidates
    with make_view(Console(stderr=True), total=total, generations=config.search.generations) as view:
        result = search(config, view)
    print(result.summary)
    tacevo, mlflow = _as_typed("tacevo"), _as_typed("mlflow")
    print(f"run: {result.directory}")
    print(f"look:   {tacevo} show {result.directory} {result.best}")
    print(f"verify: {tacevo} replay {result.directory}")
    if config.tracking.kind.value == "mlflow":
        print(f"MLflow: {mlflow} ui --backend-store-uri {without_password(config.tracking.uri)}")
    print(f"digest: {result.digest}")
    return DONE


def _estimate(options: argparse.Namespace) -> int:
    from tacevo.composition import compose
    from tacevo.estimating import describe

    print(describe(compose(options.overrides)))
    return DONE


def _as_typed(command: str) -> str:
    """Spell a command of this environment so that the user's shell finds it, activated or not."""
    if shutil.which(command):
        return command
    return os.path.relpath(Path(sys.executable).parent / command)


def _replay(options: argparse.Namespace) -> int:
    from rich.console import Console

    from tacevo.costs import in_words
    from tacevo.progress import PlainView
    from tacevo.replaying import replay

    with PlainView(Console(stderr=True)) as view:
        replayed = replay(Path(options.run), options.store, view)
    print(f"{replayed.lines} ledger lines, both archives and every candidate's source are as recorded")
    print(f"recorded: {in_words(replayed.spent)}; this replay made no call and cost nothing")
    print(f"digest: {replayed.digest}")
    return DONE


def _show(options: argparse.Namespace) -> int:
    from tacevo.showing import show_candidate, show_run

    path = Path(options.run)
    print(show_run(path) if options.candidate is None else show_candidate(path, options.candidate), end="")
    return DONE


def _check(options: argparse.Namespace) -> int:
    from tacevo.checking import check_files

    for line in check_files(options.files, task=options.task, image_size=options.image_size, as_json=options.json):
        print(line, flush=True)
    return DONE


def _data_check(options: argparse.Namespace) -> int:
    import json

    from rich.console import Console

    from tacevo.findings import describe, report
    from tacevo.inspecting import check

    found = check(options.overrides, options.output, Console(stderr=True))
    print(json.dumps(describe(found), indent=2) if options.json else report(found))
    return DIFFERENT if found.survey.leaks else DONE


def _data_show(options: argparse.Namespace) -> int:
    from rich.console import Console

    from tacevo.inspecting import show

    print(f"look: {show(options.overrides, options.output, options.width, Console(stderr=True))}")
    return DONE


def _data_simulate(options: argparse.Namespace) -> int:
    from rich.console import Console

    from tacevo.inspecting import simulate

    print(simulate(options.overrides, Console(stderr=True)))
    return DONE


def _track(options: argparse.Namespace) -> int:
    from tacevo.session import track

    print(track(Path(options.run), options.uri))
    return DONE


def _cache_ls(options: argparse.Namespace) -> int:
    from tacevo.caching import list_stores

    print(list_stores(Path(options.store), kind=options.kind, model=options.model))
    return DONE


def _cache_verify(options: argparse.Namespace) -> int:
    from tacevo.caching import verify

    problems, files = verify(Path(options.store))
    for problem in problems:
        print(problem)
    print(f"{files - len(problems)} of {files} entries are sound")
    return DIFFERENT if problems else DONE


def _cache_explain(options: argparse.Namespace) -> int:
    from tacevo.caching import explain

    print(explain(Path(options.store), options.key))
    return DONE


def _cache_export(options: argparse.Namespace) -> int:
    from rich.console import Console

    from tacevo.packing import export
    from tacevo.progress import PlainView

    with PlainView(Console(stderr=True)) as view:
        entries = export(Path(options.run), Path(options.output), options.store, view)
    print(f"{entries} entries are in {options.output}")
    return DONE


def _cache_import(options: argparse.Namespace) -> int:
    from tacevo.packing import import_file

    written, standing = import_file(Path(options.file), Path(options.store))
    print(f"{written} entries written, {standing} were there already")
    return DONE


def _doctor(options: argparse.Namespace) -> int:
    from tacevo.doctor import examine

    findings, sound = examine()
    print(findings)
    return DONE if sound else DIFFERENT


if __name__ == "__main__":
    sys.exit(main())
