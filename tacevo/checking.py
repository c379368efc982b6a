"""`tacevo check`: the gate on raw answers, as they come from a model."""

import contextlib
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from tacevo.composition import compose, facts_without_data, load_task
from tacevo.config import RunConfig
from tacevo.errors import ConfigError
from tacevo.gate.admission import Admitted
from tacevo.proposals import Task
from tacevo.records import Completion, Json, Mode, Rejection
from tacevo.rules import CURRENT
from tacevo.sandbox.client import Sandbox
from tacevo.training.numerics import environment
from tacevo.wiring import ENTRIES, build_gate


def check_files(files: Sequence[str], *, task: str, image_size: int | None, as_json: bool) -> Iterator[str]:
    """Put answers through the gate of a task, one after another.

    Args:
        files: text files with an answer each, or JSON recordings with a `response` (and its `stop_reason`) or a
            `source`.
        task: the task's name.
        image_size: in pixels; None for that of the task's data.
        as_json: whether each verdict is a JSON object (file, verdict, stage, reason, detail, parameters), or words.

    Yields:
        One line a file.

    Raises:
        ConfigError: there is no such task, or a file cannot be read.
    """
    config, judged = task_without_data(task, image_size)
    answers = [(file, _read(Path(file))) for file in files]
    with contextlib.ExitStack() as stack:
        config.store.root = stack.enter_context(tempfile.TemporaryDirectory())  # a check leaves nothing behind
        sandbox = Sandbox(entries=ENTRIES, environment=environment(config.numerics.kind), arrays={})
        gate = build_gate(config, judged.contract, stack.enter_context(sandbox).run, Mode.record, CURRENT)
        for file, completion in answers:
            verdict = _verdict(file, gate.admit(completion))
            yield json.dumps(verdict) if as_json else _words(verdict)


def task_without_data(name: str, image_size: int | None) -> tuple[RunConfig, Task]:
    """Give a task and its configuration as if its data set were there, for work that needs none.

    Raises:
        ConfigError: there is no such task, or it cannot have that image size.
    """
    config = compose([f"task={name}", *([] if image_size is None else [f"data.image_size={image_size}"])])
    return config, load_task(config, facts_without_data(config))


def _read(path: Path) -> Completion:
    """Read a file as the answer of a model."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} cannot be read as an answer: {error}") from error
    stop_reason = "end_turn"
    if path.suffix == ".json":
        text, stop_reason = _recorded(path, text)
    return Completion(text=text, model="", stop_reason=stop_reason, input_tokens=0, output_tokens=0)


def _recorded(path: Path, text: str) -> tuple[str, str]:
    """Take answer and stop reason out of a JSON recording."""
    try:
        recording = json.loads(text)
    except ValueError as error:
        raise ConfigError(f"{path} is not JSON: {error}") from error
    answer = recording.get("response", recording.get("source")) if isinstance(recording, dict) else None
    if not isinstance(answer, str):
        raise ConfigError(f"{path} needs a text `response` or `source`, as recordings have it")
    return answer, str(recording.get("stop_reason", "end_turn"))


def _verdict(file: str, admission: Admitted | Rejection) -> dict[str, Json]:
    """Give a file's verdict as the fields of its line."""
    if isinstance(admission, Admitted):
        parameters = admission.profile.parameters
        return {
            "file": file,
            "verdict": "admitted",
            "stage": None,
            "reason": None,
            "detail": None,
            "parameters": parameters,
        }
    return {
        "file": file,
        "verdict": "rejected",
        "stage": admission.stage.value,
        "reason": admission.reason.value,
        "detail": admission.detail,
        "parameters": None,
    }


def _words(verdict: dict[str, Json]) -> str:
    if verdict["verdict"] == "admitted":
        return f"{verdict['file']}: admitted, {verdict['parameters']:,} parameters"
    return f"{verdict['file']}: rejected at {verdict['stage']}: {verdict['reason']}: {verdict['detail']}"
