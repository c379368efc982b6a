"""The commands `tacevo check` (the gate on raw answers) and `tacevo doctor`."""

import argparse
import contextlib
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, MISTAKE, Parser, add_config_dir
from tacevo.config.compose import compose
from tacevo.config.conf_folder import config_roots
from tacevo.config.schema import RunConfig, StoreConfig
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.environment import machine, versions
from tacevo.errors import ConfigError, SandboxError, TacevoError
from tacevo.profile import Admitted
from tacevo.records import Completion, Json, Mode, Rejection, Task, to_json
from tacevo.rules import CURRENT
from tacevo.runs.wiring import Workbench
from tacevo.sandbox.confinement import report
from tacevo.text import listed, printable
from tacevo.typed import parse

#: The verdict on a file that is not an answer.
_UNREADABLE = "unreadable"


def add_check(parser: Parser) -> None:
    """Describe `tacevo check`."""
    parser.description = (
        "Put raw answers through the gate: text files, or JSON recordings with a `response`. The exit status is 0 "
        "also where answers are rejected; --json says which. It is 2 where a file cannot be read; the others are "
        "judged all the same."
    )
    parser.add_argument("files", nargs="+", metavar="FILE", help="a text file, or JSON with a `response` or `source`")
    parser.add_argument("--task", default="force", metavar="NAME", help="whose contract to apply (default: force)")
    parser.add_argument(
        "--image-size", type=int, metavar="PIXELS", help="side of the images (default: that of the task's data)"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    add_config_dir(parser)
    parser.set_defaults(command=_check)


def _check(options: argparse.Namespace) -> int:
    status = DONE
    for verdict in check_files(options.files, task=options.task, image_size=options.image_size):
        if verdict["verdict"] == _UNREADABLE:
            status = MISTAKE
            print(f"error: {printable(str(verdict['detail']))}", file=sys.stderr, flush=True)
        if options.json or verdict["verdict"] != _UNREADABLE:
            print(json.dumps(verdict) if options.json else printable(_words(verdict)), flush=True)
    return status


def check_files(files: Sequence[str], *, task: str, image_size: int | None) -> Iterator[dict[str, Json]]:
    """Put answers through the gate of a task; yield what is found of each file.

    A file is a text with an answer, or a JSON recording with a `response` (and its `stop_reason`) or a `source`. Found
    are file, verdict, stage, reason, detail and parameters; a file that is not an answer, or cannot be read, has the
    verdict `unreadable`. Without an image size, in pixels, that of the task's data holds.

    Raises:
        ConfigError: the task does not exist.
    """
    config, judged = task_without_data(task, image_size)
    facts = facts_without_data(config)
    with tempfile.TemporaryDirectory() as store:  # a check leaves nothing behind
        config = replace(config, store=StoreConfig(root=store))
        with Workbench(config, judged, facts, Mode.record) as bench:
            gate = bench.gate(CURRENT)
            for file in files:
                try:
                    answer = _read(Path(file))
                except ConfigError as error:
                    yield {**_verdict(file, _UNREADABLE), "detail": str(error)}
                else:
                    yield _judged(file, gate.admit(answer))


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
        raise ConfigError(got, place=str(path), expected="the file of an answer: text in UTF-8") from error
    stop_reason = "end_turn"
    if path.suffix == ".json":
        text, stop_reason = _recorded(path, text)
    return Completion(text=text, model="", stop_reason=stop_reason, input_tokens=0, output_tokens=0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Recording:
    """What is read of a JSON recording: a `response`, or else a `source`."""

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


def _judged(file: str, admission: Admitted | Rejection) -> dict[str, Json]:
    """Return the gate's verdict on a file as the fields of its line."""
    if isinstance(admission, Admitted):
        return {**_verdict(file, "admitted"), "parameters": admission.profile.parameters}
    return {**_verdict(file, "rejected"), **to_json(admission)}


def _verdict(file: str, verdict: str) -> dict[str, Json]:
    return {"file": file, "verdict": verdict, "stage": None, "reason": None, "detail": None, "parameters": None}


def _words(verdict: dict[str, Json]) -> str:
    if verdict["verdict"] == "admitted":
        return f"{verdict['file']}: admitted, {verdict['parameters']:,} parameters"
    return f"{verdict['file']}: rejected at {verdict['stage']}: {verdict['reason']}: {verdict['detail']}"


def add_doctor(parser: Parser) -> None:
    """Describe `tacevo doctor`."""
    parser.set_defaults(command=_doctor)


def _doctor(options: argparse.Namespace) -> int:
    findings, sound = examine()
    print(findings)
    return DONE if sound else DIFFERENT


def examine() -> tuple[str, bool]:
    """Check machine, packages, sandbox and directories; return the findings as text, and whether a search can run.

    The confinement is what confined the candidate that was tried, or what the machine offers if none could be tried.
    """
    held: list[Mapping[str, str]] = []
    checks: dict[str, Callable[[], str]] = {
        "configs": lambda: listed(map(str, config_roots())),
        "sandbox": partial(_sandbox, held.append),
        "current directory": _directory,
    }
    results = {name: _tried(check) for name, check in checks.items()}
    confinement = held[0] if held else report()
    sections = [
        ("machine", [f"{key}: {value}" for key, value in machine().items()]),
        ("versions", [f"{key}: {value}" for key, value in versions().items()]),
        ("confinement", [f"{key}: {value}" for key, value in confinement.items()]),
        ("keys", [f"ANTHROPIC_API_KEY: {'set' if os.environ.get('ANTHROPIC_API_KEY') else 'not set'}"]),
        ("checks", [f"{'ok  ' if good else 'FAIL'} {name}: {text}" for name, (good, text) in results.items()]),
    ]
    text = "\n".join("\n".join([f"{title}:", *(f"  {line}" for line in lines)]) for title, lines in sections)
    return text, all(good for good, _ in results.values())


def _tried(check: Callable[[], str]) -> tuple[bool, str]:
    try:
        return True, check()
    except (TacevoError, OSError) as error:
        return False, str(error)


def _sandbox(notice: Callable[[Mapping[str, str]], None]) -> str:
    """Put a baseline through the gate: zygote, torch, numerics, fork and probe."""
    config, task = task_without_data("force", 32)
    facts = facts_without_data(config)
    with tempfile.TemporaryDirectory() as store:  # no recorded probe may answer instead
        config = replace(config, store=StoreConfig(root=store))
        with Workbench(config, task, facts, Mode.record, notice=notice) as bench:
            verdict = bench.gate(CURRENT).inspect(task.baseline)
    if isinstance(verdict, Rejection):
        got = f"{verdict.stage}, {verdict.reason}: {verdict.detail}"
        raise SandboxError(got, expected="the baseline of task force to be admitted")
    return f"the baseline of task force is admitted, with {verdict.profile.parameters:,} parameters"


def _directory() -> str:
    """Write a file where runs and stores go by default."""
    with tempfile.NamedTemporaryFile(dir=Path.cwd()) as file:
        file.write(b"tacevo")
    return f"writable, {shutil.disk_usage(Path.cwd()).free / 2**30:.1f} GiB free"
