"""Whether the labels of a data set are what a task asks for, told before any image is decoded."""

from collections.abc import Sequence

import yaml

from tacevo.config.compose import read_named
from tacevo.config.schema import RunConfig, TaskConfig
from tacevo.errors import ConfigError
from tacevo.records import Contract, DataFacts, Instruction, Json, Kind, Task
from tacevo.search.proposals import system_prompt


def require_fit(task: TaskConfig, *, kind: Kind, outputs: int, names: Sequence[str]) -> None:
    """Refuse labels that are not what a task asks a network for.

    Args:
        task: the task.
        kind: of the labels.
        outputs: the number of regressed values or of classes.
        names: of these, for the message.

    Raises:
        ConfigError: the labels are of the other kind, or of another number than the task's outputs.
    """
    if kind is not task.kind:
        raise ConfigError(
            f"task.kind is {task.kind}, but the data set's labels are for {kind}; data=csv gives regression, "
            "data=folder classification, data=numpy what the type of its labels says (floats or whole numbers), "
            "data=tacverse what task.name says"
        )
    if outputs != task.outputs:
        shown = ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")
        raise ConfigError(
            f"task.outputs is {task.outputs}, but the data set has {outputs} ({shown}); set "
            f"task.outputs={outputs}, or choose other data"
        )


def facts_without_data(config: RunConfig) -> DataFacts:
    """Describe the data set that a task expects, for work that needs none of its images."""
    return DataFacts(
        fingerprint="",
        kind=config.task.kind,
        counts=(0, 0, 0),
        in_channels=3,
        image_size=config.data.image_size,
        outputs=config.task.outputs,
        names=tuple(config.task.output_names),
    )


def load_task(config: RunConfig, facts: DataFacts) -> Task:
    """Read a task's baseline and texts, and fit its contract to the data set.

    Raises:
        ConfigError: a file is missing or malformed, the data set has another number of outputs than the task, or the
            library has fewer instructions than `prompts.pool`.
    """
    task = config.task
    require_fit(task, kind=facts.kind, outputs=facts.outputs, names=facts.names)
    contract = Contract(
        class_name=task.class_name,
        kind=task.kind,
        loss=task.loss,
        in_channels=facts.in_channels,
        image_size=facts.image_size,
        outputs=task.outputs,
        output_argument=task.output_argument,
    )
    library = _read_library(task.instructions)
    config.prompts.check_library(len(library["mutations"]))
    template = read_named("task.system", task.system)
    try:
        system = system_prompt(template, contract, facts.names)
    except ValueError as error:
        raise ConfigError(f"task.system: {error}") from error
    return Task(
        name=task.name,
        contract=contract,
        baseline=read_named("task.baseline", task.baseline),
        system=system,
        instructions=tuple(Instruction(id=entry["id"], text=entry["text"]) for entry in library["mutations"]),
        crossover=library["crossover"],
    )


def _read_library(name: str) -> dict[str, Json]:
    """Read a prompt library and check its shape."""
    key = "task.instructions"
    try:
        library: dict[str, Json] = yaml.safe_load(read_named(key, name))
    except yaml.YAMLError as error:
        raise ConfigError(f"{key} names {name}, which is not YAML: {error}") from error
    shaped = isinstance(library, dict) and set(library) == {"crossover", "mutations"}
    if not shaped or not isinstance(library["crossover"], str) or not isinstance(library["mutations"], list):
        raise ConfigError(f"{key} names {name}, which needs `crossover: TEXT` and `mutations: [...]`")
    ids = []
    for number, entry in enumerate(library["mutations"], 1):
        sound = isinstance(entry, dict) and set(entry) == {"id", "text"}
        if not sound or not all(isinstance(value, str) and value.strip() for value in entry.values()):
            raise ConfigError(f"{key} names {name}, whose mutation {number} needs an `id` and a `text`; got {entry!r}")
        ids.append(entry["id"])
    if not ids or len(set(ids)) != len(ids):
        raise ConfigError(f"{key} names {name}, whose mutations need different ids, at least one; got {ids}")
    return library
