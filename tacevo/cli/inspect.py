"""The commands `tacevo check` (the gate on raw answers) and `tacevo doctor`."""

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, MISTAKE, tell
from tacevo.config.conf_folder import config_roots
from tacevo.config.schema import StoreConfig
from tacevo.config.task_texts import facts_without_data
from tacevo.environment import machine, versions
from tacevo.errors import ConfigError, SandboxError, TacevoError
from tacevo.records import Json, Mode, Rejection
from tacevo.reproduce.bits import compare as bits
from tacevo.rules import CURRENT
from tacevo.runs.answers import UNREADABLE, judged_answers, task_without_data
from tacevo.runs.wiring import Workbench
from tacevo.sandbox.confinement import report
from tacevo.storage.files import write_durably
from tacevo.text import listed


def run_check(names: Sequence[str], task: str, image_size: int | None, *, as_json: bool) -> int:
    """Put the answers of files through the gate."""
    status = DONE
    verdicts = judged_answers([Path(name) for name in names], task=task, image_size=image_size)
    for name, judged in zip(names, verdicts, strict=True):
        verdict = judged | {"file": name}  # as it was typed
        if verdict["verdict"] == UNREADABLE:
            status = MISTAKE
            tell(f"error: {verdict['detail']}", error=True, flush=True)
        if as_json or verdict["verdict"] != UNREADABLE:
            tell(json.dumps(verdict) if as_json else _words(verdict), flush=True)
    return status


def _words(verdict: dict[str, Json]) -> str:
    if verdict["verdict"] == "admitted":
        changed = f"; {verdict['detail']}" if verdict["detail"] else ""
        return f"{verdict['file']}: admitted, {verdict['parameters']:,} parameters{changed}"
    return f"{verdict['file']}: rejected at {verdict['stage']}: {verdict['reason']}: {verdict['detail']}"


def run_doctor(file: str | None) -> int:
    """Print what this machine has, and write its bits into a file."""
    if file is not None and Path(file).is_dir():
        raise ConfigError("a directory", place=f"--report {file}", expected="the name of a file to be written")
    findings, sound, compared = examine()
    tell(findings)
    if file is None and not all(each.is_sound for each in compared):
        tell("please send us the file of `tacevo doctor --report FILE`")
    if file is not None:
        write_durably(Path(file), json.dumps(bits.report(compared), indent=1) + "\n")
        tell(f"the report is in {file}; it names no file and no person")
    return DONE if sound else DIFFERENT


def examine() -> tuple[str, bool, Sequence[bits.Compared]]:
    """Check machine, packages, sandbox, directories and bits.

    The confinement is what confined the candidate that was tried, or what the machine offers if none could be tried.

    Returns:
        The findings as text; whether all is well; and the bits, by level of numerics.
    """
    held: list[Mapping[str, str]] = []
    checks: dict[str, Callable[[], str]] = {
        "configs": lambda: listed(map(str, config_roots())),
        "sandbox": partial(_sandbox, held.append),
        "current directory": _directory,
    }
    results = {name: _tried(check) for name, check in checks.items()}
    confinement = held[0] if held else report()
    tell("computing what portable numerics give on this CPU: some seconds", error=True, flush=True)
    compared = bits.compare()
    sections = [
        ("machine", [f"{key}: {value}" for key, value in machine().items()]),
        ("versions", [f"{key}: {value}" for key, value in versions().items()]),
        ("confinement", [f"{key}: {value}" for key, value in confinement.items()]),
        ("keys", [f"ANTHROPIC_API_KEY: {'set' if os.environ.get('ANTHROPIC_API_KEY') else 'not set'}"]),
        ("bits", [f"{each.level}: {each}" + (f": {each.last_line}" if each.last_line else "") for each in compared]),
        ("checks", [f"{'ok  ' if good else 'FAIL'} {name}: {text}" for name, (good, text) in results.items()]),
    ]
    text = "\n".join("\n".join([f"{title}:", *(f"  {line}" for line in lines)]) for title, lines in sections)
    is_sound = all(good for good, _ in results.values()) and all(each.is_sound for each in compared)
    return text, is_sound, compared


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
