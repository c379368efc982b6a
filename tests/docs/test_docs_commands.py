"""Promise: what a page tells to type can be typed, and does what the page says."""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from checkout import ROOT
from commands import tacevo
from presupposed import write_presupposed
from rooms import ROOMS
from smallest import Once

from tacevo.cli.app import _parsed
from tacevo.config.compose import compose, compose_estimate, spread
from tacevo.config.conf_folder import check_experiment

PAGES = (
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *(ROOT / folder / "README.md" for folder in ("benchmarks", "cache", "cache/published")),
)

#: With a task that `tacevo init` makes first, or a part that the page has a reader write.
OF_A_READER = re.compile(r"task=(shear|\w+-paper)|\bparts/\w+\.py|\[first\b|\$[A-Z]+")

#: A file that a page has a reader write: its name, and the text.
WRITTEN = re.compile(r"^```python\n# (\S+\.py)\n(.*?)^```$", re.MULTILINE | re.DOTALL)

#: A block that a page fences, and what it begins with where it is a file, or a test of one.
FENCED = re.compile(r"^```(?:sh|python|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
OF_A_FILE = re.compile(r"# \S+\.py\b|import pytest")

#: A command of ours, or one that a page has between two; a line of Python; what is typed elsewhere.
TYPED = re.compile(r"    (?:.*[ /])?(tacevo [a-z][^#]+)|    ((?:sed|mkdir|unzip) [^#]+)")
PYTHON = re.compile(r"    (import tacevo|(?:\w+ = )?(?:tacevo|run|study|sweep|table|print)[.(].*)")
ELSEWHERE = re.compile(r"    (pip|make|cmp|export|source|env|ray|mlflow|python|docker|apptainer|cp)\b")

#: Commands that train, ask a model, need a cluster or draw thousands of images: until their first line, in a copy.
LONG = re.compile(
    r"tacevo (search(?!.* --estimate)|study|noise|tabulate|judge|extend|export|data (show|simulate))\b|--retrain"
)

#: Of these, what the stores or a table have, and a network that learns in one epoch: to their end.
SHORT = re.compile(r"search experiment=(demo( llm=grammar| tracking\S+)*$|table )|export runs/demo g04s01 -o network")

#: What this machine may lack: a key, a head of Ray, a server, a GPU.
LACKS = re.compile(r"_API_KEY|HEAD:6379|localhost:8000|/dev/nvidiactl")

#: What a reader puts in place of a page's words.
STANDS_FOR = {
    r"pairs sweeps/tells": "pairs cache/published/words-temperature.zip --reference temperature.start=0.1 -o tells",
    r"pairs sweeps/parents": "pairs cache/published/operator-or-search.zip -o parents",
    r"\bRUN data.sensor=": "runs/tacverse data.sensor=",
    r"\bRUN data=csv": "sweeps/tiny/none-seed0 data=csv",
    r"\bruns/NAME data=tacverse": "runs/tacverse data=tacverse",
    r"\bRUN RUN\b|\bruns/FORCE runs/GRATING": "runs/demo sweeps/tiny/none-seed0",
    r"(?<!run\.dir=)\bruns/(?!tacverse)[\w-]+|\bRUN\b(?!\.zip)": "runs/demo",
    r"(?<!--into )\bsweeps/(?!tiny)[\w-]+|\bSWEEP\b": "sweeps/tiny",
    r"(?<=runs/demo )g\d\ds\d\d": "g04s01",
    r"\bRUN\.zip": "cache/published/grating-grammar.zip",
    r"track DIR": "track runs/demo",
    r"\b(PATH|OTHER)\b": "IMAGES",
    r"root=DIR": "root=tacverse",
    r"unzip -d": "unzip -oqd",  # they lie there already
    r"parts check sizes": "parts check pareto",  # one that is installed
}

#: What makes the Python of pages small: the demo's seed, short trainings, and nothing that needs a sweep of 20 seeds.
SMALLER = {
    '"seed=1"': '"seed=0"',
    "generations=30": "generations=7",
    '"none", "drift"': '"none", "fixed_temperature"',
    "study(None, ": 'study(None, "data.images=100", "data.image_size=32", seeds=5, ',
    "seeds=5": "seeds=4, epochs=1",
    "seeds=12": "seeds=2",
    "images=600": "images=60",
    "sweeps/mine": "sweeps/tiny",
    "sweeps/tells": "cache/published/telling-losses.zip",
    'run.export("g12s05", "DIR", like="search")': 'tacevo.open("runs/demo").export("g04s01", "DIR")',
    "regret(run)": "regret(tacevo.open(next(Path('runs').glob('grating-*'))))",
    "table.size_and_power(sweep, seeds=10)": "",
}


def indented(page: Path) -> str:
    """Return a page with its fenced blocks indented, and without comments that have a line of their own in a block."""

    def indent(block: re.Match[str]) -> str:
        lines = [line for line in block[1].splitlines() if not line.startswith("#")]
        return block[0] if OF_A_FILE.match(block[1]) else "\n".join(f"    {line}" if line else "" for line in lines)

    return FENCED.sub(indent, page.read_text(encoding="utf-8"))


def commands_of(page: Path) -> list[tuple[str, list[str]]]:
    """List the commands of a page, each with the lines of output that the page shows below it.

    They are without comments and optional words, and have the first of several choices. Those with `...` lack a part.
    """
    text = re.sub(r" *\\\n *", " ", indented(page))
    commands: list[tuple[str, list[str]]] = []
    shown: list[str] = []
    for line in text.splitlines():
        if typed := TYPED.match(line):
            command = typed[2] or re.sub(r" \[.*?\]|\|[A-Z]\S*", "", typed[1])
            shown = []
            if "..." not in command:
                commands.append((command.strip(), shown))
        elif line.startswith("    ") and not PYTHON.match(line) and not ELSEWHERE.match(line):
            shown.append(line)
        elif line or shown:
            shown = []
    return commands


def write_files_of(page: Path, folder: Path) -> None:
    """Write the files that a page has a reader write."""
    for name, text in WRITTEN.findall(page.read_text(encoding="utf-8")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")


def python_of(page: Path) -> list[str]:
    """List the lines of Python of a page."""
    return [line.strip() for line in indented(page).splitlines() if PYTHON.match(line)]


COMMANDS = {page: commands_of(page) for page in PAGES}
EACH = dict.fromkeys(command for commands in COMMANDS.values() for command, _ in commands if command[:6] == "tacevo")


@pytest.mark.room(*ROOMS)
@pytest.mark.few(30)
@pytest.mark.parametrize("command", [command for command in EACH if not OF_A_READER.search(command)])
def test_written_command_can_be_typed(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command line reads it; every value of a search's settings is composed; an estimate needs no model."""
    for name in ("check_place", "check_sweep"):  # runs/NAME is not there
        monkeypatch.setattr(f"tacevo.cli.commands.{name}", lambda path: None)
    words = shlex.split(command)[1:]
    _parsed(words)
    if words[0] != "search":
        return
    if "--estimate" not in words:
        check_experiment(words)
    values = spread([word for word in words if "=" in word and not word.startswith("hydra")])
    for number in range(max(map(len, values))):
        overrides = [one[min(number, len(one) - 1)] for one in values]
        (compose_estimate if "--estimate" in words else compose)(overrides)


@pytest.fixture(scope="session")
def presupposed(once: Once) -> Path:
    """Return a directory with what the pages presuppose; no test may change it."""
    return once("pages", write_presupposed)


@pytest.mark.room(*ROOMS)
@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if COMMANDS[page] or python_of(page)],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_page_does_what_it_says(page: Path, presupposed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its commands run in its order in a directory of their own, the long ones to their first line, then its Python.

    What the page shows below a command that runs to its end, that command prints.
    """
    for name in ("ANTHROPIC_API_KEY", "ANTHROPIC_AUTH_TOKEN", "OPENAI_API_KEY"):
        monkeypatch.delenv(name, raising=False)
    folder, printed = Path(shutil.copytree(presupposed, tmp_path / "page", symlinks=True)), ""
    write_files_of(page, folder)
    for command, shown in COMMANDS[page]:
        assert [name for name in re.findall(r"sweeps/[\w-]+-[0-9a-f]{8}", command) if name not in printed] == []
        typed = command
        for words, real in STANDS_FOR.items():
            typed = re.sub(words, real, typed)
        if not typed.startswith("tacevo"):
            subprocess.run(typed, shell=True, cwd=folder, check=True)
            continue
        arguments = shlex.split(typed)[1:]
        if LONG.search(typed) and not SHORT.search(typed):
            answer = started(arguments, shutil.copytree(folder, tmp_path / "copy", symlinks=True))
            shutil.rmtree(tmp_path / "copy")
        elif "--estimate" in arguments:
            answer = estimated(*arguments, folder=presupposed)
        else:
            before = "import io, sys; sys.stdin = io.StringIO('y')"  # what asks is answered
            answer = tacevo(*arguments, cwd=folder, before=before).stdout
        lines = [line.split() for line in answer.splitlines()]
        assert [line for line in shown if line.split() not in [["..."], *lines]] == [], answer
        printed += answer
    if python := python_of(page):
        code = "\n".join(["from pathlib import Path", "import tacevo", *python])
        for written, small in SMALLER.items():
            code = code.replace(written, small)
        subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment(), check=True)


@cache
def estimated(*arguments: str, folder: Path) -> str:
    """Return what an estimate says; it measures this machine for up to 80 s, and several pages have the same."""
    return tacevo(*arguments, cwd=folder).stdout


def started(arguments: list[str], folder: Path) -> str:
    """Return the output of a command that is stopped after its first line, or wants what this machine lacks."""
    with subprocess.Popen(
        [sys.executable, "-m", "tacevo.cli.app", *arguments],
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        told = process.stdout.readline()
        os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does
        told += process.stdout.read()
    assert told
    assert "Traceback" not in told
    assert not re.search(r"^(error|refused|different): ", told, re.MULTILINE) or LACKS.search(told), told
    return told


def environment() -> dict[str, str]:
    """Return the environment of a process that finds the checkout's packages from anywhere."""
    return {**os.environ, "PYTHONPATH": str(ROOT)}
