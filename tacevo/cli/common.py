"""What all commands have in common: the parser, the exit status, directories of stores and results."""

import argparse
import os
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, NoReturn

from tacevo.environment import as_typed
from tacevo.errors import ConfigError
from tacevo.parts.registry import is_there
from tacevo.storage.places import sibling
from tacevo.text import listed, nearest, printable

#: Exit status: done; a comparison or verification failed; the user's mistake; interrupted by Ctrl-C, or by SIGTERM.
DONE, DIFFERENT, MISTAKE, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143

#: The formats of a figure's files.
Format = Literal["pdf", "svg", "png"]

FORMATS: tuple[Format, ...] = ("pdf", "svg", "png")

#: Stands above a last line `digest: ...`, which programs read, and says whose it is.
TO_CITE = "the digest in the last line; it is that of the {}"


def existing_store(name: str | None) -> str | None:
    """Return what `--store` names; a mistyped directory would be made and filled again.

    Raises:
        ConfigError: it is not a directory.
    """
    if name is not None and not Path(name).is_dir():
        expected = "the directory of a run's stores"
        raise ConfigError(name, place="--store", expected=expected, remedy=sibling(Path(name)))
    return name


def place_of_results(run: str, output: str | None, name: str) -> Path:
    """Return where the results of one run or sweep go: where `-o` says, else under a name in its directory.

    Raises:
        ConfigError: nothing is written into a bundle, and `-o` is missing.
    """
    source = Path(run)
    if output:
        return Path(output)
    if source.is_file() or source.parent.is_file():
        got, remedy = f"what was published, {source}", f"name by -o where to write {name}"
        raise ConfigError(got, expected="a directory", remedy=remedy)
    return source / name


def places_of(runs: Sequence[str], output: str | None, name: str) -> list[Path]:
    """Return where the results of every run go: of one, as `place_of_results`; of several, below that of `-o`.

    Raises:
        ConfigError: as `place_of_results`; or several have no place, or two have one name.
    """
    if len(runs) == 1:
        return [place_of_results(runs[0], output, name)]
    names = check_names(runs)
    if output is None:
        raise ConfigError("several runs", place="-o", expected="the directory that theirs are made in")
    return [Path(output) / one for one in names]


def check_names(runs: Sequence[str]) -> list[str]:
    """Return the names of runs and sweeps, which their results bear.

    Raises:
        ConfigError: two have one name.
    """
    names = [Path(run).resolve().name.removesuffix(".zip") for run in runs]
    twice = sorted({one for one in names if names.count(one) > 1})
    if twice:
        raise ConfigError(
            f"{listed(twice)} twice",
            place="RUN",
            expected="runs with different names, which their results bear",
            remedy="give one a name of its own by a link, as in `ln -s RUN NAME`, or give it to a command of its own",
        )
    return names


def output_directory(name: str | Path) -> Path:
    """Make the directory of results before any work is done for them.

    Raises:
        ConfigError: it cannot be made, or nothing can be written into it.
    """
    directory, expected = Path(name), "a directory that results can be written to"
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"one that cannot ({error.strerror})", place=str(directory), expected=expected) from error
    if not os.access(directory, os.W_OK | os.X_OK):
        raise ConfigError(
            "a write-protected directory", place=str(directory), expected=expected, remedy="name another by -o"
        )
    return directory


def comparison(sweep: Path) -> str:
    """Return the command that compares the arms of a sweep: its tables alone where no figure can be drawn here."""
    command = "ablations" if is_there("analysis.figures") else "tables"
    return f"{as_typed('tacevo')} {command} {shlex.quote(str(sweep))}"


def tell(text: object = "", *, error: bool = False, end: str = "\n", flush: bool = False) -> None:
    """Print a text, whoever wrote it, so that the terminal obeys none of it; `error` is on standard error."""
    print(printable(str(text)), file=sys.stderr if error else sys.stdout, end=end, flush=flush)


def tell_markdown(text: str) -> None:
    """Print Markdown of ours: on a terminal without its marks, which are for files and pages."""
    if sys.stdout.isatty():
        text = re.sub(r"(?m)^\*\*(.*)\*\*$", r"\1", text)
        text = re.sub(r"\\([\\`*\[\]{}|~$^@#_<&!:.+\-=>)])", r"\1", text)
    tell(text, end="" if text.endswith("\n") else "\n")


def agreed(question: str, yes: bool) -> bool:
    """Ask before something goes for good; without a terminal, where nobody answers, the answer is no."""
    if yes:
        return True
    try:
        answer = input(printable(f"{question} [y/N] "))
    except EOFError:
        answer = ""
        tell()
    if answer.strip().lower() in {"y", "yes"}:
        return True
    tell("nothing was removed (--yes asks nothing)")
    return False


def whole_number(text: str) -> int:
    """Read an option that counts something.

    Raises:
        argparse.ArgumentTypeError: it is not an integer of at least 1.
    """
    if text.isdecimal() and int(text) >= 1:
        return int(text)
    raise argparse.ArgumentTypeError(f"expected an integer of at least 1; got {text}")


class Parser(argparse.ArgumentParser):
    """A parser whose mistakes are errors as all others, and whose files of overrides (`@FILE`) may have comments.

    The parser of the given command is the parsed `parser`, so that a mistake names this command.
    """

    #: Writes what stands below the arguments, before the examples, where it takes too long to be written each time.
    write_more: Callable[[], str] | None = None

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.set_defaults(parser=self)

    def format_help(self) -> str:
        """Write the help: what a command does above its arguments, examples and what follows them below."""
        described, mark, examples = (self.description or "").partition("Examples:\n")
        more = "" if self.write_more is None else f"{self.write_more()}\n\n"
        if mark or more:
            self.description, self.epilog = described.rstrip(), f"{more}{mark}{examples}"
        return super().format_help()

    @property
    def ask_help(self) -> str:
        """Where the user finds what the command takes."""
        return f"`{self.prog} --help` says what can be given"

    @property
    def option_names(self) -> list[str]:
        """The long names of its options, and of those above it none."""
        return [name for name in self._option_string_actions if name.startswith("--")]

    def error(self, message: str) -> NoReturn:
        """Refuse a command line.

        Raises:
            ConfigError: always.
        """
        error = sys.exc_info()[1]  # from Python 3.12 on, argparse puts the first one behind its own
        problem = error if error is None or error.__context__ is None else error.__context__
        if isinstance(problem, OSError):  # argparse could not open the file of an @FILE
            got, expected = f"one that cannot be read ({problem.strerror})", "a text file with one override a line"
            raise ConfigError(got, place=f"@{problem.filename}", expected=expected)
        raise ConfigError(message, place=self.prog, remedy=self.ask_help)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a command or a choice that is unknown, and offer the nearest (argparse calls this)."""
        if action.choices is None or value in action.choices:
            return
        known = [str(choice) for choice in action.choices]
        raise ConfigError(
            str(value),
            place=" ".join([self.prog, *action.option_strings[:1]]),
            expected=f"one of {listed(known)}",
            remedy=nearest(str(value), known, self.ask_help),
        )

    def convert_arg_line_to_args(self, arg_line: str) -> list[str]:
        """Read one line of a file of overrides."""
        text = arg_line.strip()
        text.encode(errors="surrogateescape").decode()  # from Python 3.12 on, argparse reads what is not UTF-8
        return [] if text.startswith("#") or not text else [text]
