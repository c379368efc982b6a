"""Answers of a model, put through the gate as a search would, without a search."""

import contextlib
import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacevo.config.compose import compose
from tacevo.config.schema import RunConfig, StoreConfig
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.errors import ConfigError
from tacevo.profile import Admitted
from tacevo.records import Completion, Json, Mode, Rejection, Task, to_json
from tacevo.rules import CURRENT
from tacevo.runs.wiring import Workbench
from tacevo.storage.places import sibling
from tacevo.text import listed
from tacevo.typed import parse

#: The verdict on a file that is not an answer.
UNREADABLE = "unreadable"


def judged_answers(answers: Sequence[str | Path], *, task: str, image_size: int | None) -> Iterator[dict[str, Json]]:
    """Put answers, texts or files, through the gate of a task; yield what it says of each.

    A file is a text with an answer, or a JSON recording with a `response` (and its `stop_reason`) or a `source`. The
    task's baseline counts as a network that the model was given. Said are file (None of a text), verdict, stage,
    reason, detail and parameters; the detail of an admitted one is what was changed in it, if anything was. A file that
    is not an answer, or cannot be read, has the verdict `unreadable`. Without an image size, in pixels, that of the
    task's data holds.

    Raises:
        ConfigError: the task does not exist.
    """
    config, judged = task_without_data(task, image_size)
    facts = facts_without_data(config)
    with tempfile.TemporaryDirectory() as store:  # a check leaves nothing behind
        config = replace(config, store=StoreConfig(root=store))
        with Workbench(config, judged, facts, Mode.record) as bench:
            gate = bench.gate(CURRENT)
            for given in answers:
                file = str(given) if isinstance(given, Path) else None
                try:
                    answer = _read(given) if isinstance(given, Path) else _answered(given)
                except ConfigError as error:
                    yield {**_verdict(file, UNREADABLE), "detail": str(error)}
                else:
                    yield _judged(file, gate.admit(answer, judged.baseline), gate.notes(answer, judged.baseline))


def task_without_data(name: str, image_size: int | None) -> tuple[RunConfig, Task]:
    """Return a task and its configuration as if its data set were there, for work that needs none.

    Raises:
        ConfigError: the task does not exist, or it cannot have that image size.
    """
    config = compose([f"task={name}", *([] if image_size is None else [f"data.image_size={image_size}"])])
    return config, load_task(config, facts_without_data(config))


def _read(path: Path) -> Completion:
    """Read a file as the answer of a model."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        got = f"one that cannot be read ({error.strerror})" if isinstance(error, OSError) else str(error)
        remedy = "" if path.exists() else sibling(path)
        raise ConfigError(
            got, place=str(path), expected="the file of an answer: text in UTF-8", remedy=remedy
        ) from error
    stop_reason = "end_turn"
    if path.suffix == ".json":
        text, stop_reason = _recorded(path, text)
    return _answered(text, stop_reason)


def _answered(text: str, stop_reason: str = "end_turn") -> Completion:
    return Completion(text=text, model="", stop_reason=stop_reason, input_tokens=0, output_tokens=0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Recording:
    """The fields that are read of a JSON recording: a `response`, or else a `source`."""

    response: str | None = None
    source: str | None = None
    stop_reason: str = "end_turn"


def _recorded(path: Path, text: str) -> tuple[str, str]:
    """Return the answer and the stop reason of a JSON recording."""
    recording = parse(_Recording, _whole(text), place=str(path), error=ConfigError)
    answer = recording.source if recording.response is None else recording.response
    if answer is None:
        keys = listed(sorted(json.loads(text)), "no field")
        raise ConfigError(keys, place=str(path), expected="a field `response` or `source` with a text")
    return answer, recording.stop_reason


def _whole(text: str) -> str:
    r"""Replace the lone surrogates of JSON, such as `\ud83d`, by question marks, as in an answer from a server."""
    if "\\ud" in text.lower():
        with contextlib.suppress(ValueError, RecursionError):  # which `parse` names
            return json.dumps(json.loads(text), ensure_ascii=False).encode(errors="replace").decode()
    return text


def _judged(file: str | None, admission: Admitted | Rejection, notes: Sequence[str]) -> dict[str, Json]:
    """Return the gate's verdict on a file, and what it changed there, as the fields of its line."""
    if isinstance(admission, Admitted):
        parameters = admission.profile.parameters
        return {**_verdict(file, "admitted"), "detail": "; ".join(notes) or None, "parameters": parameters}
    return {**_verdict(file, "rejected"), **to_json(admission)}


def _verdict(file: str | None, verdict: str) -> dict[str, Json]:
    return {"file": file, "verdict": verdict, "stage": None, "reason": None, "detail": None, "parameters": None}
