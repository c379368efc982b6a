"""Whether the labels of a data set are what a task asks for, told before any image is decoded."""

from collections.abc import Sequence

from tacevo.config import TaskConfig
from tacevo.errors import ConfigError
from tacevo.records import Kind


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
