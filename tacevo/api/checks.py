"""Checks before a search: answers through the gate, and a data set."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from tacevo.api import frames
from tacevo.errors import ConfigError
from tacevo.parts.registry import needing_parts
from tacevo.records import Json, to_json
from tacevo.runs.answers import judged_answers

if TYPE_CHECKING:
    import pandas as pd


def check(*answers: str | Path, task: str = "force", image_size: int | None = None) -> pd.DataFrame:
    """Put answers of a model, or networks, through the gate, as `tacevo check`; columns: docs/python.md.

    Args:
        answers: texts, such as `run.source("g12s05")`; or files as `pathlib.Path`: text, or JSON with a `response` or
            a `source`.
        task: whose contract is applied.
        image_size: side of the images in pixels; that of the task's data if None.

    Raises:
        ConfigError: the task does not exist; or a text is the name of a file, which must be a path.
    """
    for answer in answers:
        if isinstance(answer, str) and "\n" not in answer and os.path.exists(answer):
            raise ConfigError(repr(answer), place="answers", expected="a text, or a file as pathlib.Path")
    return frames.frame(judged_answers(answers, task=task, image_size=image_size), frames.CHECKS)


@needing_parts()
def check_data(*overrides: str, sheet: str | os.PathLike[str] | None = None, quiet: bool = False) -> dict[str, Json]:
    """Load a data set as a search would, count it and draw a contact sheet, as `tacevo data check`.

    Args:
        overrides: as of `tacevo data check`, such as `"task=force", "data=csv", "data.root=DIR"`.
        sheet: the picture to write: .png, .pdf or .svg; `contact-sheet-FINGERPRINT.png` here if None.
        quiet: whether to show no progress on standard error.

    Returns:
        What the command's `--json` prints; `duplicates` and `warnings` say what is wrong, `sheet` where the picture is.

    Raises:
        ConfigError: an override is wrong.
        DataError: the data set is broken, or does not suit the task.
    """
    from rich.console import Console

    from tacevo.runs.data_check import inspect_data  # a part

    console = Console(stderr=True, quiet=quiet)
    inspection = to_json(inspect_data(overrides, None if sheet is None else os.fspath(sheet), console))
    assert isinstance(inspection, dict)
    return inspection
