"""A command is a function: argparse reads its command line from its signature, and its help from its docstring."""

import argparse
import inspect
import re
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import EnumType
from functools import partial
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from tacevo.cli.common import Parser

#: Options that have a short form, too.
_SHORT = {"output": "-o", "multirun": "-m", "cfg": "-c", "yes": "-y"}

#: Options whose name Python or the field writes otherwise.
_LONG = {"licence": "--license"}

#: Characters of an option's choices from which on they stand in its help, and not in the usage.
_MOST = 40

#: Marks that an annotation adds: an argument that must be given at least once; an option that may be given several
#: times; an option that no help shows, since it is there for users of Hydra.
AT_LEAST_ONE, REPEATED, HIDDEN = object(), object(), object()

#: The width of every help, in characters, on any terminal.
WIDTH = 80


@dataclass(frozen=True, slots=True)
class Takes:
    """How one value is read: the metadata of an annotation, as in `Annotated[str, Takes("RUN", read=place)]`."""

    #: What the help calls it.
    name: str
    #: Reads it; raises argparse.ArgumentTypeError where it is wrong.
    read: Callable[[str], Any] = str
    #: What an option stands for where no value follows it; None where one must.
    bare: Any = None


class UsageError(Exception):
    """Arguments that do not go together, as a command says."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """A command: a function, or several below one name.

    A positional parameter is an argument, `*NAME` any number of them, a keyword parameter an option of its name: a
    `bool` is given or not, a `Literal` is one of its values, one without a default must be given.
    """

    #: First the line in the list of all commands; then what the command's own help says above and below its arguments,
    #: from `Examples:` on; then in `Args:` what each parameter means. Without the middle, the line stands there, too.
    doc: str
    function: Callable[..., int] | None = None
    below: Mapping[str, "Command"] = field(default_factory=dict)
    #: Whether `@FILE` stands for the lines of a file.
    reads_files: bool = False
    #: What is said where the command is interrupted; None for what is said of every command.
    interrupted: str | None = None
    #: Writes what stands before the examples, where that takes too long to be written for each command.
    more: Callable[[], str] | None = None

    @property
    def line(self) -> str:
        """What the list of all commands says of it."""
        line = self.doc.partition("\n")[0].rstrip(".")
        return f"{line[0].lower()}{line[1:]}"

    def describe(self, parser: Parser) -> None:
        """Let a parser read the command's arguments, write its help, and call it (`options.command`)."""
        text, _, arguments = self.doc.partition("\n\nArgs:\n")
        first, _, rest = text.partition("\n\n")
        parser.formatter_class = Paragraphs
        parser.description = rest if rest and not rest.startswith("Examples:") else f"{first}\n\n{rest}"
        parser.write_more = self.more
        if self.reads_files:
            parser.fromfile_prefix_chars = "@"
        if self.interrupted is not None:
            parser.set_defaults(interrupted=self.interrupted)
        if self.function is not None:
            meanings = _meanings(arguments)
            for parameter in inspect.signature(self.function).parameters.values():
                _add(parser, parameter, meanings[parameter.name])
            parser.set_defaults(command=partial(_call, self.function))
        if self.below:
            choices = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
            for name, command in self.below.items():
                command.describe(choices.add_parser(name, help=_escaped(command.line)))


def command(**settings: Any) -> Callable[[Callable[..., int]], Command]:
    """Make a function a command; the settings are those of `Command`."""

    def decorate(function: Callable[..., int]) -> Command:
        return Command(doc=inspect.getdoc(function) or "", function=function, **settings)

    return decorate


def _meanings(arguments: str) -> dict[str, str]:
    """Read what each parameter means, from the lines below `Args:` of a docstring."""
    named = re.findall(r"(?m)^ {4}(\w+): (.+(?:\n {8}.+)*)", arguments)
    return {name: _escaped(" ".join(text.split())) for name, text in named}


def _escaped(text: str) -> str:
    """Write a text as argparse takes it, which fills in `%(default)s`."""
    return text.replace("%", "%%")


def _add(parser: Parser, parameter: inspect.Parameter, meaning: str) -> None:
    """Let a parser read one parameter."""
    is_required = parameter.default is parameter.empty
    settings: dict[str, Any] = {"help": meaning}
    kind, takes, marks = _unpacked(parameter.annotation)
    if HIDDEN in marks:
        settings["help"] = argparse.SUPPRESS
    if parameter.default is False:
        settings["action"] = "store_true"
    else:
        settings |= {"metavar": takes.name, "type": takes.read} if takes else {"choices": _choices(kind)}
        if len(", ".join(settings.get("choices", ()))) > _MOST:
            settings |= {"metavar": parameter.name.upper(), "help": f"{meaning}: {', '.join(settings['choices'])}"}
        if parameter.kind is parameter.VAR_POSITIONAL:
            settings["nargs"] = "+" if AT_LEAST_ONE in marks else "*"
        elif parameter.kind is not parameter.KEYWORD_ONLY:
            settings["nargs"] = None if is_required else "?"
        elif REPEATED in marks:
            settings |= {"action": "append", "default": []}
        else:
            settings |= {"required": is_required, "default": None if is_required else parameter.default}
            if isinstance(parameter.default, tuple):
                settings["nargs"] = "+"
            elif takes and takes.bare is not None:
                settings |= {"nargs": "?", "const": takes.bare}
    if parameter.kind is parameter.KEYWORD_ONLY:
        names = _LONG.get(parameter.name, f"--{parameter.name.replace('_', '-')}"), _SHORT.get(parameter.name)
        parser.add_argument(*filter(None, reversed(names)), dest=parameter.name, **settings)
    else:
        parser.add_argument(parameter.name, **settings)


def _unpacked(annotation: Any) -> tuple[Any, Takes | None, tuple[Any, ...]]:
    """Return the type of one value, how it is read, and further marks; of `T | None` those of T."""
    found: list[Any] = []
    while get_origin(annotation) is not Literal and (inner := get_args(annotation)):
        found += getattr(annotation, "__metadata__", ())
        annotation = next(each for each in inner if each is not NoneType)
    takes = next((each for each in reversed(found) if isinstance(each, Takes)), None)  # an alias may say more
    return annotation, takes, tuple(each for each in found if not isinstance(each, Takes))


def _choices(kind: Any) -> list[str]:
    """Return the values of a `Literal` or of an enumeration."""
    return list(map(str, kind if isinstance(kind, EnumType) else get_args(kind)))


def _call(function: Callable[..., int], options: argparse.Namespace) -> int:
    """Call the function of a command with what was parsed; return its exit status."""
    given, arguments, keywords = vars(options), list[Any](), dict[str, Any]()
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind is parameter.VAR_POSITIONAL:
            arguments += given[parameter.name]
        elif parameter.kind is parameter.KEYWORD_ONLY:
            keywords[parameter.name] = given[parameter.name]
        else:
            arguments.append(given[parameter.name])
    try:
        return function(*arguments, **keywords)
    except UsageError as error:
        parser: Parser = options.parser
        parser.error(str(error))


class Paragraphs(argparse.HelpFormatter):
    """Fills paragraphs to one width (`WIDTH`); one with an indented line, such as examples, stays as it is."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=WIDTH)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraphs = [
            paragraph if "\n " in paragraph else textwrap.fill(" ".join(paragraph.split()), width)
            for paragraph in text.strip().split("\n\n")
        ]
        return "\n\n".join(paragraphs)
