"""Promise: who takes one of the first tasks of CONTRIBUTING.md finds its room, and the files that it names."""

import re

import pytest
from checkout import ROOT

TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")

TASKS = re.findall(r"^### (\d+)\. (.+?)\n(.+?)(?=^#)", TEXT.partition("\n## Ten first tasks\n")[2], re.M | re.S)


def named(task: str, part: str) -> list[str]:
    """List the paths that a part of a task names, such as its room."""
    (words,) = re.findall(rf"^- \*\*{part}:\*\* (.+(?:\n  .+)*)", task, re.MULTILINE)
    return re.findall(r"`([\w.]+/[\w./]+)`", words)


def test_there_are_ten() -> None:
    """They are numbered in order."""
    assert [int(number) for number, _, _ in TASKS] == list(range(1, 11))


@pytest.mark.parametrize("task", [text for _, _, text in TASKS], ids=[title for _, title, _ in TASKS])
def test_task_names_what_is_there(task: str) -> None:
    """One room, files to begin with of which the first lies in that room, files of tests, and when it is done."""
    (room,) = named(task, "Room")
    start, tests = named(task, "Start"), named(task, "Test")
    assert (ROOT / room).is_dir()
    assert start[0].startswith(f"{room}/")
    assert tests
    assert all(name.startswith("tests/") for name in tests)
    assert [name for name in [*start, *tests, *named(task, "Done")] if not (ROOT / name).is_file()] == []
