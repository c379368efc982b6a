"""The `tacevo` command."""

import argparse
import contextlib
import signal
import sys
import textwrap
from collections.abc import Callable, Sequence
from functools import partial
from typing import NoReturn

from tacevo import __version__
from tacevo.cli.commands import OURS, WITHOUT_ANALYSIS
from tacevo.cli.common import DIFFERENT, DONE, INTERRUPTED, MISTAKE, TERMINATED, Parser, tell
from tacevo.cli.edge import Terminated, check_analysis, edge
from tacevo.cli.signature import WIDTH, Paragraphs
from tacevo.config.conf_folder import groups, reading_own
from tacevo.errors import BundleError, ConfigError, DivergenceError, TacevoError
from tacevo.parts.kinds import COMMAND_GROUPS, COMMANDS
from tacevo.parts.registry import Part, needing_parts, ours, parts, raised
from tacevo.text import nearest, unbroken

#: What replaced commands of the last release.
_REPLACED = {
    "cache explain": "cat cache/KIND/KE/KEY.json",
    "cache ls": "tacevo cache verify",
    "continue": "tacevo extend RUN search.generations=N",
    "paper": "tacevo report RUN... --latex",
    "rm": "rm -r RUN",
    "sweep": "tacevo show SWEEP",
    "watch": "tacevo report RUN --follow",
}

_DESCRIPTION = "Architecture search for vision-based tactile sensors that can be replayed bit for bit."

_EPILOG = """\
examples:
  # a small search, in minutes
  tacevo search experiment=demo
  # a sweep of four searches: two arms, two seeds
  tacevo search -m experiment=demo ablation=none,fixed_temperature seed=0,1
  # run it again from its stores, and compare
  tacevo replay runs/NAME
  # and train its best network and five others again, bit for bit
  tacevo replay runs/NAME --retrain 5
  # what its fitnesses are worth: its elites under other training seeds
  tacevo noise runs/NAME
  # its best networks and the baseline, trained fully with 20 seeds each
  tacevo study runs/NAME
  # one candidate, its numbers and its source
  tacevo show runs/NAME g02s03
  # one file with which anybody can replay it
  tacevo publish runs/NAME -o NAME.zip"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return its exit status."""
    return run(partial(_parsed, sys.argv[1:] if arguments is None else arguments), is_process=arguments is None)


def run(read: Callable[[], argparse.Namespace], *, is_process: bool) -> int:
    """Run the command that is read, and say in a line why it did not come to its end; return its exit status.

    `is_process` says that this process has nothing else to do.
    """
    options = argparse.Namespace(interrupted="nothing was begun")
    with edge():
        try:
            with needing_parts():
                options = read()
                with reading_own(getattr(options, "config_dir", None)):
                    status: int = options.command(options)
            return status
        except KeyboardInterrupt as interruption:
            _end_at_once(is_process=is_process)
            tell(f"\ninterrupted; {_kept(interruption) or options.interrupted}", error=True)
            return TERMINATED if isinstance(interruption, Terminated) else INTERRUPTED
        except BrokenPipeError:
            with contextlib.suppress(OSError):
                sys.stdout.close()
            return DONE
        except TacevoError as error:
            _end_at_once(is_process=is_process)
            names = {BundleError: "refused", DivergenceError: "different"}
            tell(f"{names.get(type(error), 'error')}: {error}", error=True)
            return DIFFERENT if type(error) in names else MISTAKE
        except OSError as error:  # a full disk, a directory without permission
            _end_at_once(is_process=is_process)
            named = error.filename is not None and error.strerror is not None
            tell(f"error: {unbroken(f'{error.filename}: {error.strerror}' if named else str(error))}", error=True)
            return MISTAKE


def _end_at_once(*, is_process: bool) -> None:
    """Let a process that says its last words end at the next Ctrl-C: Python would print where that struck."""
    if is_process:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def _kept(interruption: BaseException | None) -> str:
    """Return what an interruption says is kept, or what the one says that was on its way when this one struck."""
    while interruption is not None and not (isinstance(interruption, KeyboardInterrupt) and str(interruption)):
        interruption = interruption.__context__
    return "" if interruption is None else str(interruption)


def _parsed(arguments: Sequence[str]) -> argparse.Namespace:
    """Read the command line; overrides may stand after options too, where argparse itself accepts no more of them."""
    command, second = [*(word for word in arguments if not word.startswith("-")), None, None][:2]
    parser = _parser(command, second)
    try:
        options, rest = parser.parse_known_args(arguments)
    except UnicodeDecodeError:
        parser.error("a file of overrides (@FILE) must be text in UTF-8, with one override a line")
    strange = [word for word in rest if word.startswith("-") or "=" not in word]
    if strange or (rest and "overrides" not in options):
        _refuse(options.parser, strange or rest)
    if rest:
        options.overrides = [*options.overrides, *rest]
    return options


def _refuse(parser: Parser, words: Sequence[str]) -> NoReturn:
    """Refuse words that a command does not take, and say what was perhaps meant by the first.

    Raises:
        ConfigError: always.
    """
    name, _, value = words[0].partition("=")
    bare = name.lstrip("-")
    options = [option for option in parser.option_names if option != "--help"]
    if not name.startswith("-"):
        remedy = ""
    elif bare in {*groups(), "seed"} or "." in bare:
        remedy = f"a setting is written without dashes: {bare}={value or [*words[1:], 'VALUE'][0]}"
    else:
        remedy = nearest(bare, [option.lstrip("-") for option in options], "", before="--")
    raise ConfigError(f"unrecognized arguments: {' '.join(words)}", place=parser.prog, remedy=remedy or parser.ask_help)


def _parser(command: str | None, second: str | None) -> Parser:
    """Describe the command line: all commands in a line each, and the given one, by its first word, in full."""
    # A name of ours is ours, whatever is installed: nobody needs to look.
    known = ours(COMMANDS) if command in COMMANDS.ours else parts(COMMANDS)
    parser = Parser(
        prog="tacevo",
        description=f"{_DESCRIPTION}\n\n{_listed(known)}",
        epilog=_EPILOG,
        formatter_class=Paragraphs,
    )
    parser.add_argument("--version", action="version", version=f"tacevo {__version__}")
    parser.set_defaults(interrupted="the same command does what is left")  # which may be all
    names = {part.name for part in known}
    for gone in (command, f"{command} {second}"):
        if gone in _REPLACED and gone not in names:
            remedy = f"use `{_REPLACED[gone]}`"
            raise ConfigError(gone, place="tacevo", expected="a command of this release", remedy=remedy)
    commands = parser.add_subparsers(
        required=True, metavar="COMMAND", help="one of those above; each has its own --help"
    )
    for part in known:
        line = _line(part)
        described = commands.add_parser(part.name, description=f"{line[0].upper()}{line[1:]}.")
        if part.name == command:
            if part.name not in WITHOUT_ANALYSIS:
                check_analysis()
            OURS[part.name].describe(described) if part.is_ours else _describe(part, described)
    return parser


def _describe(part: Part, parser: Parser) -> None:
    """Let a command of somebody's describe itself.

    Raises:
        ConfigError: it raises, or names no function that runs.
    """
    describes = part.load()
    try:
        describes(parser)
    except Exception as error:
        raise ConfigError(raised(error), place=part.place, expected="a function that describes arguments") from error
    if not callable(parser.get_default("command")):
        expected = "a function that runs, by `parser.set_defaults(command=FUNCTION)`"
        raise ConfigError("none", place=part.place, expected=expected)


def _line(part: Part) -> str:
    """Return the line of a command in the help; of one that is not ours, which package has it."""
    return OURS[part.name].line if part.is_ours else f"of {part.origin}"


def _listed(known: Sequence[Part]) -> str:
    """List all commands, a line each, by group: argparse has no groups of them."""
    width = max(len(part.name) for part in known)
    others = {part.name: _line(part) for part in known if not part.is_ours}
    lines = []
    groups = {title: {name: OURS[name].line for name in group} for title, group in COMMAND_GROUPS.items()}
    for title, group in (groups | ({"parts": others} if others else {})).items():
        lines.append(f"{title}:")
        for name, line in group.items():
            indent = " " * (width + 4)
            lines += textwrap.wrap(line, WIDTH, initial_indent=f"  {name.ljust(width)}  ", subsequent_indent=indent)
        lines.append("")
    return "\n".join(lines).rstrip()


if __name__ == "__main__":
    sys.exit(main())
