"""A task's texts, and whether the labels of a data set are what it asks for."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import yaml

from tacevo.choices import Carrier, RecordedTask
from tacevo.config.conf_folder import config_file, read_named
from tacevo.config.schema import RunConfig, TaskConfig, is_a
from tacevo.config.strict_yaml import read_yaml
from tacevo.errors import ConfigError
from tacevo.evolution.carriers import LEVELS
from tacevo.evolution.prompts import system_prompt
from tacevo.records import Contract, DataFacts, Instruction, Kind, Record, Task
from tacevo.text import counted, listed
from tacevo.typed import convert

_is_sentence = is_a("a sentence on one line", lambda text: text.strip() and len(text.splitlines()) == 1)

_is_worded = is_a("an id and a text that are not empty", lambda entry: entry.id.strip() and entry.text.strip())


@dataclass(frozen=True, slots=True, kw_only=True)
class _Library(Record):
    """The file of a task's instructions."""

    crossover: str
    mutations: tuple[Annotated[Instruction, _is_worded], ...]
    #: What carries a temperature in words, from the least departure from the parent to the boldest.
    boldness: tuple[Annotated[str, _is_sentence], ...] = ()


def check_fit(task: TaskConfig, *, kind: Kind, outputs: int, names: Sequence[str]) -> None:
    """Refuse labels that are not what a task asks a network for.

    Raises:
        ConfigError: the labels are of the other kind, or of another number than the task's outputs.
    """
    if kind is not task.kind:
        raise ConfigError(
            str(task.kind),
            place="task.kind",
            expected=f"{kind}, as the labels of the data set are",
            remedy="data=csv is for regression, data=folder for classification, data=numpy for what the type of its "
            "labels says (floats or integers), data=tacverse for what task.name says",
        )
    if outputs != task.outputs:
        shown = ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")
        expected = f"{outputs}, as the data set has ({shown})"
        remedy = f"set task.outputs={outputs}, or choose other data"
        raise ConfigError(str(task.outputs), place="task.outputs", expected=expected, remedy=remedy)


#: Words that a task copied from one of the sensor's own should not keep.
_WORDS = {
    RecordedTask.force: r"forces?",
    RecordedTask.grating: r"gratings?|grooves?",
    RecordedTask.hardness: r"hard|hardness",
    RecordedTask.shape: r"shapes",
}


def left_of_others(task: TaskConfig) -> list[str]:
    """Say what the files of a user's task have kept of the task that they were copied from, a sentence each.

    These are names of other outputs, and words of the sensor's own tasks. Of such a task itself, and of words in the
    names of the user's, nothing is said.

    Raises:
        ConfigError: a file cannot be read.
    """
    if task.name in list(RecordedTask):
        return []
    left = []
    if len(task.output_names) not in {0, task.outputs}:
        left.append(f"task.outputs={task.outputs}, and task.output_names={listed(task.output_names)}")
    names = " ".join((task.name, *task.output_names)).casefold()
    others = "|".join(word for sensor, word in _WORDS.items() if sensor not in names)
    for key in ("system", "instructions", "baseline"):
        name = getattr(task, key)
        lines = read_named(f"task.{key}", name).split("\n")
        kept = [
            f"{match[0]!r} in line {number}"
            for number, line in enumerate(lines, start=1)
            if (match := re.search(rf"\b({others or '(?!)'})\b", line, re.IGNORECASE))
            and not (key == "instructions" and line.startswith("#"))  # a comment, which no model reads
        ]
        if kept:
            file = os.path.relpath(config_file(name, f"task.{key}"))
            left.append(f"{file} tells the model of another task: {listed(kept)}")
    return left


def facts_without_data(config: RunConfig) -> DataFacts:
    """Describe the data set that a task expects, for work without its images."""
    return DataFacts(
        fingerprint="",
        kind=config.task.kind,
        counts=(0, 0, 0),
        in_channels=3,
        image_size=config.data.image_size,
        outputs=config.task.outputs,
        names=tuple(config.task.output_names),
    )


def contract_of(task: TaskConfig, facts: DataFacts) -> Contract:
    """Fit the contract of a task to a data set; raises as `check_fit`."""
    check_fit(task, kind=facts.kind, outputs=facts.outputs, names=facts.names)
    return Contract(
        class_name=task.class_name,
        kind=task.kind,
        loss=task.loss,
        in_channels=facts.in_channels,
        image_size=facts.image_size,
        outputs=task.outputs,
        output_argument=task.output_argument,
    )


def load_task(config: RunConfig, facts: DataFacts) -> Task:
    """Read a task's baseline and texts, and fit its contract to the data set.

    Raises:
        ConfigError: a file is missing or malformed, the data set has another number of outputs than the task, or the
            library has fewer instructions than `prompts.pool`.
    """
    task = config.task
    contract = contract_of(task, facts)
    library = _read_library(task.instructions)
    config.prompts.check_library(len(library.mutations))
    template = read_named("task.system", task.system)
    try:
        system = system_prompt(template, contract, facts.names)
    except ValueError as error:
        raise ConfigError(str(error), place="task.system") from error
    return Task(
        name=task.name,
        contract=contract,
        baseline=read_named("task.baseline", task.baseline),
        system=system,
        instructions=library.mutations,
        crossover=library.crossover,
        boldness=_boldness(library, task.instructions) if config.temperature.carrier is Carrier.words else (),
    )


def _boldness(library: _Library, name: str) -> tuple[str, ...]:
    """Return the sentences that carry a temperature in words.

    Raises:
        ConfigError: the library has another number of them, or two that are equal.
    """
    sentences = library.boldness
    if len(sentences) != LEVELS or len(set(sentences)) < LEVELS:
        raise ConfigError(
            "equal sentences" if len(set(sentences)) < len(sentences) else counted(len(sentences), "sentence"),
            place=f"task.instructions, {name}, boldness",
            expected=f"{LEVELS} different sentences, from the least departure from the parent to the boldest, with "
            "temperature.carrier=words",
            remedy="copy those of conf/library/force/instructions.yaml, or choose another carrier",
        )
    return sentences


def _read_library(name: str) -> _Library:
    """Read the instructions of a task."""
    place = f"task.instructions, {name}"
    try:
        written = read_yaml(read_named("task.instructions", name), only_text=True)
    except yaml.YAMLError as error:
        raise ConfigError(f"a file that is not YAML ({error})", place=place) from error
    library = convert(_Library, written, place=place, error=ConfigError)
    ids = [entry.id for entry in library.mutations]
    if not ids or len(set(ids)) != len(ids):
        raise ConfigError(str(ids), place=f"{place}, mutations", expected="different ids, at least one")
    return library
