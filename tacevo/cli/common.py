"""What all commands of `tacevo` have in common: the parser, the exit status, the word for an override.

Nothing here imports a library, so that help is quick.
"""

import argparse
import os
from pathlib import Path
from typing import Any

from tacevo.errors import ConfigError

#: Exit status: done; a comparison or verification failed; the user's mistake; interrupted.
DONE, DIFFERENT, MISTAKE, INTERRUPTED = 0, 1, 2, 130

OVERRIDE = "GROUP=CHOICE or KEY=VALUE, as in Hydra, or @FILE with one of them a line"


def existing_store(name: str | None) -> str | None:
    """Take what `--store` names; a mistyped folder would be made, and filled anew.

    Raises:
        ConfigError: it is no folder.
    """
    if name is not None and not Path(name).is_dir():
        raise ConfigError(f"--store needs the folder that holds a run's stores; {name} is no folder")
    return name


def place_of_results(output: str | None, source: str, name: str, what: str) -> Path:
    """Say where results go: where the user wants them, else into the folder that they are of.

    Args:
        output: where the user wants them.
        source: the folder or the bundle that they are of.
        name: what they are called in a folder.
        what: what they are, for the message, e.g. `the figures of a published run`.

    Raises:
        ConfigError: they are of a bundle, into which nothing is written, and the user named no place.
    """
    if output:
        return Path(output)
    if Path(source).is_file():
        raise ConfigError(f"{source} is a file; say by -o where {what} go")
    return Path(source) / name


def output_folder(name: str | Path) -> Path:
    """Make the folder of results before any work is done for them.

    Raises:
        ConfigError: it cannot be made, or nothing can be written into it.
    """
    folder = Path(name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"results need a folder; {folder} can be none: {error.strerror}") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ConfigError(f"results need a folder that can be written to; {folder} cannot; name another one by -o")
    return folder


class Parser(argparse.ArgumentParser):
    """A parser whose files of overrides (`@FILE`) may have empty lines and comments.

    The parser of the given command is the parsed `parser`, so that a mistake shows this command's usage.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.set_defaults(parser=self)

    def convert_arg_line_to_args(self, arg_line: str) -> list[str]:
        """Read one line of a file of overrides."""
        text = arg_line.strip()
        return [] if text.startswith("#") or not text else [text]
