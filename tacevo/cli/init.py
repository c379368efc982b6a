"""The command `tacevo init`."""

import os
import re
import shlex
from pathlib import Path

from tacevo.choices import SensorTask
from tacevo.cli.common import DONE, tell
from tacevo.config.conf_folder import own_root
from tacevo.config.new_task import write_task
from tacevo.config.schema import TaskConfig
from tacevo.config.task_texts import left_of_others
from tacevo.environment import as_typed
from tacevo.records import Kind

#: The small experiment for labels of each kind.
_SMALL = {Kind.regression: "published_force", Kind.classification: "published_grating"}

#: The images of the paper's tasks, as released (docs/paper_data.md): of gratings one pattern and the seven sizes.
_RELEASED = "data=tacverse data.root=tacverse"
_OF_GRATINGS = " data.pattern=Blackdot 'data.spacings_mm=[0.3,0.5,0.75,1,1.25,1.5,1.75]'"


def run_init(name: str, like: str | None, supplement: str | None, config_dir: str | None) -> int:
    """Write a task of a user's own."""
    if like is None:
        like = "force" if supplement is None else re.split(r"[-_]", name)[0]
    task = write_task(name, like, None if supplement is None else Path(supplement))
    files = {
        f"task/{name}.yaml": "outputs and their names",
        task.system: "what the images show",
        task.instructions: "what a mutation does",
        task.baseline: f"where a search starts; its {task.output_argument}={task.outputs} is that of outputs, too",
    }
    places = {file: os.path.relpath(own_root() / file) for file in files}
    for file, what in files.items():
        tell(f"wrote:  {places[file]} ({'to edit: ' if supplement is None else ''}{what})")
    for words in left_of_others(task):
        tell(f"edit:   {words}")
    images = _images(task)
    if supplement is not None:
        images = _RELEASED + (_OF_GRATINGS if like == SensorTask.grating else "")
    tacevo, own = as_typed("tacevo"), f"task={name} {images}"
    where = "" if config_dir is None else f" --config-dir {shlex.quote(config_dir)}"
    tell(f"verify: {tacevo} check {shlex.quote(places[task.baseline])} --task {name}{where}")
    if like in list(SensorTask):  # the simulation goes by the name, and is for the old outputs
        lent = f"task={name} task.name={like}"
        tell(f"try:    {tacevo} search experiment=demo {lent}{where}  # before the edit, on simulated images")
    own = f"experiment={_SMALL[task.kind] if supplement is None else f'paper_{like}'} {own}{where}"
    model = "" if supplement is None else " llm=anthropic"  # which experiments of the paper leave open
    tell(f"look:   {tacevo} data check {own}{model}  # says what is still the other task's")
    tell(f"next:   {tacevo} search {own}{model}")
    return DONE


def _images(task: TaskConfig) -> str:
    """Return overrides that name recorded images of a task's kind."""
    if task.kind is Kind.classification:
        return "data=folder data.root=IMAGES"
    columns = shlex.quote(f"data.target_columns=[{','.join(task.output_names)}]")
    return f"data=csv data.root=IMAGES data.table=labels.csv {columns}"
