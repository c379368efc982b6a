"""The warnings about a data set, or about a task for it: each is shown, and stops no search."""

from collections.abc import Sequence
from pathlib import Path

from tacevo.choices import SensorTask
from tacevo.config.schema import RunConfig, TaskConfig
from tacevo.config.task_texts import left_of_others
from tacevo.data.dataset import Dataset
from tacevo.data.exposure import doubtful_images
from tacevo.data.listing import doubtful_files
from tacevo.data.source import listed
from tacevo.parts.source import Catalogue
from tacevo.records import Kind, Task
from tacevo.runs.datasets import source_of

#: The heading below which a task's system prompt says what the images show.
_HEADING = "## The task\n"


def warnings_of(config: RunConfig, task: Task, dataset: Dataset, catalogue: Catalogue | None = None) -> list[str]:
    """Say what is probably wrong, a sentence each; the catalogue is listed where the caller does not have it.

    Raises:
        DataError: the recording cannot be read any more.
        ConfigError: nor can the files of the task.
    """
    warnings = left_of_others(config.task)
    names = dataset.facts.names
    if not config.data.facts.is_release and not _suit(config.task, names):
        outputs = listed(config.task.output_names) or "gratings"
        warnings.append(
            f"task={config.task.name} is for {outputs}, and the data set has {listed(names)}; the prompt tells the "
            f'model: "{told(task)}" (`tacevo init NAME --like {config.task.name}` begins a task of your own)'
        )
    if config.data.facts.is_looked_up:
        from tacevo.runs.table_answers import table_of

        table = table_of(config)
        warnings += [f"{table.path} is made up: no network was trained for it"] if table.header.made_up else []
    elif not config.data.facts.is_made:
        listed_now = source_of(config).catalogue() if catalogue is None else catalogue
        warnings += doubtful_files(listed_now, Path(config.data.root or ""))
        warnings += doubtful_images(listed_now, dataset)
    return warnings


def told(task: Task) -> str:
    """Return what the prompt tells the model of the images and of what a network makes of them, in one line."""
    _, _, rest = task.system.partition(_HEADING)
    return " ".join((rest or task.system).partition("\n\n")[0].split())


def _suit(task: TaskConfig, names: Sequence[str]) -> bool:
    """Answer whether labels of these names are what a task says they are; a unit may follow a name, as in `fx_N`."""
    if task.output_names:
        own = [name.casefold() for name in task.output_names]
        folded = [name.casefold() for name in names]
        return all(any(name == each or name.startswith(f"{each}_") for each in own) for name in folded)
    is_sizes = all(any(letter.isdigit() for letter in name) for name in names)
    return task.kind is Kind.regression or is_sizes or task.name != SensorTask.grating
