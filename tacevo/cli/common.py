"""What all commands have in common: the parser, the exit status, directories of stores and results."""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from tacevo.errors import ConfigError
from tacevo.text import listed, nearest

#: Exit status: done; a comparison or verification failed; the user's mistake; interrupted by Ctrl-C, or by SIGTERM.
DONE, DIFFERENT, MISTAKE, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143

OVERRIDE = "GROUP=CHOICE or KEY=VALUE, as in Hydra, or @FILE with one of them a line"

#: A run, in the help of the commands that read one.
RUN = "the directory or bundle of a run, or SWEEP.zip/JOB"

#: A run or a sweep, in the help of the commands that read either.
RUNS = "the directory or bundle of a run or a sweep, or SWEEP.zip/JOB"


def existing_store(name: str | None) -> str | None:
    """Return what `--store` names; a mistyped directory would be made and filled again.

    Raises:
        ConfigError: it is not a directory.
    """
    if name is not None and not Path(name).is_dir():
        raise ConfigError(name, place="--store", expected="the directory of a run's stores")
    return name


def place_of_results(output: str | None, source: str, name: str, what: str) -> Path:
    """Return where results go: where the user wants them, else under a name in the directory of the run or sweep.

    The message calls them, e.g., `the figures of a published run`.

    Raises:
        ConfigError: nothing is written into a bundle, and the user named no place.
    """
    if output:
        return Path(output)
    if Path(source).is_file() or Path(source).parent.is_file():
        raise ConfigError(
            f"what was published, {source}", expected="a directory", remedy=f"name by -o where to write {what}"
        )
    return Path(source) / name


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

    #: Writes the epilog, where that takes too long to be written for each command.
    write_epilog: Callable[[], str] | None = None

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.set_defaults(parser=self)

    def format_help(self) -> str:
        """Write the help."""
        if self.write_epilog is not None:
            self.epilog = self.write_epilog()
        return super().format_help()

    @property
    def _ask_help(self) -> str:
        return f"`{self.prog} --help` says what can be given"

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
        raise ConfigError(message, place=self.prog, remedy=self._ask_help)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a command or a choice that is unknown, and offer the nearest (argparse calls this)."""
        if action.choices is None or value in action.choices:
            return
        known = [str(choice) for choice in action.choices]
        raise ConfigError(
            str(value),
            place=" ".join([self.prog, *action.option_strings[:1]]),
            expected=f"one of {listed(known)}",
            remedy=nearest(str(value), known, self._ask_help),
        )

    def convert_arg_line_to_args(self, arg_line: str) -> list[str]:
        """Read one line of a file of overrides."""
        text = arg_line.strip()
        text.encode(errors="surrogateescape").decode()  # from Python 3.12 on, argparse reads what is not UTF-8
        return [] if text.startswith("#") or not text else [text]
