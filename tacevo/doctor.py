"""`tacevo doctor`: whether this machine has what a run needs."""

import os
import shutil
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from tacevo.checking import task_without_data
from tacevo.choices import Numerics
from tacevo.confdir import conf_root
from tacevo.errors import SandboxError, TacevoError
from tacevo.records import Mode, Rejection
from tacevo.rules import CURRENT
from tacevo.rundir import machine, versions
from tacevo.sandbox.client import Notice, Sandbox
from tacevo.sandbox.confinement import in_force, report
from tacevo.training.numerics import environment
from tacevo.wiring import ENTRIES, build_gate


def examine() -> tuple[str, bool]:
    """Look at machine, packages, sandbox and folders.

    The confinement is what held the candidate that was tried, or what the machine has, where none could be.

    Returns:
        The findings as text, and whether a search can run.
    """
    held: list[tuple[str, ...]] = []
    checks: dict[str, Callable[[], str]] = {
        "configs": _configs,
        "sandbox": partial(_sandbox, held.append),
        "current folder": _folder,
    }
    results = {name: _tried(check) for name, check in checks.items()}
    confinement = in_force(held[0]) if held else report()
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


def _configs() -> str:
    return str(conf_root())


def _sandbox(notice: Notice) -> str:
    """Put a baseline through the gate: zygote, torch, numerics, fork and probe."""
    config, task = task_without_data("force", 32)
    with tempfile.TemporaryDirectory() as store:
        config.store.root = store  # nothing recorded may answer instead
        with Sandbox(entries=ENTRIES, environment=environment(Numerics.portable), arrays={}, notice=notice) as sandbox:
            verdict = build_gate(config, task.contract, sandbox.run, Mode.record, CURRENT).inspect(task.baseline)
    if isinstance(verdict, Rejection):
        raise SandboxError(
            f"the baseline of task force is rejected: {verdict.stage}, {verdict.reason}: {verdict.detail}"
        )
    return f"the baseline of task force is admitted, with {verdict.profile.parameters:,} parameters"


def _folder() -> str:
    """Write a file where runs and stores go by default."""
    with tempfile.NamedTemporaryFile(dir=Path.cwd()) as file:
        file.write(b"tacevo")
    return f"writable, {shutil.disk_usage(Path.cwd()).free / 2**30:.1f} GiB free"
