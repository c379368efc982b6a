"""Promise: however a command is started, with what around it, and however it is ended, a person reads one line."""

import io
import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import TextIO

import pytest
from checkout import ROOT
from waiting import eventually

from tacevo.cli import edge
from tacevo.cli.app import main
from tacevo.cli.commands import WITHOUT_ANALYSIS
from tacevo.errors import telling


def python(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python with our packages on its path, and more variables of the environment."""
    path = os.pathsep.join([environment.pop("PYTHONPATH", str(cwd)), *sys.path])
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": path, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def test_package_is_the_command(tmp_path: Path) -> None:
    """`python -m tacevo` takes what `tacevo` takes."""
    assert python("-m", "tacevo", "--version", cwd=tmp_path).stdout.startswith("tacevo ")
    told = python("-m", "tacevo", "show", "nowhere", cwd=tmp_path)
    assert (told.returncode, told.stderr[:15]) == (2, "error: nowhere:")


def script() -> str:
    """Return what the installed script `tacevo` runs."""
    module, _, function = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"][
        "tacevo"
    ].partition(":")
    return f"import sys; from {module} import {function}; sys.exit({function}())"


@pytest.mark.parametrize("started", [("-m", "tacevo"), ("-c", script())])
def test_interrupt_while_modules_are_imported_is_one_line(started: tuple[str, str], tmp_path: Path) -> None:
    """Before the command itself can say what is kept: the first import from outside sends the signal."""
    (tmp_path / "argparse.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nsum(range(10**8))\n")
    told = python(*started, "show", "nowhere", cwd=tmp_path)
    assert (told.returncode, told.stdout) == (130, "")
    assert [line for line in told.stderr.splitlines() if line] == ["interrupted; nothing was begun"]


@pytest.mark.few(2)
@pytest.mark.parametrize("module", sorted(WITHOUT_ANALYSIS))
def test_command_that_is_said_to_need_no_analysis_imports_none(module: str, tmp_path: Path) -> None:
    """Else a package of that name would be run."""
    (tmp_path / "analysis.py").write_text("raise SystemExit('I was run')\n")
    assert python("-c", f"import tacevo.cli.{module}", cwd=tmp_path).returncode == 0


@pytest.mark.parametrize(
    ("name", "command"),
    [("analysis.py", "show"), ("analysis/__init__.py", "replay"), ("analysis/__init__.py", "study")],
)
def test_package_of_the_same_name_is_named_and_not_run(name: str, command: str, bundle: Path, tmp_path: Path) -> None:
    """Of any command that needs ours: one line with both places."""
    strange = tmp_path / name
    strange.parent.mkdir(exist_ok=True)
    strange.write_text("raise SystemExit('I was run')\n")
    told = python("-m", "tacevo", command, str(bundle), cwd=tmp_path)
    assert told.returncode == 2
    (line,) = [line for line in told.stderr.splitlines() if line.startswith("error: ")]
    assert str(strange).removesuffix("/__init__.py") in line
    assert str(ROOT / "analysis") in line
    assert "I was run" not in told.stderr
    assert "Traceback" not in told.stderr


@pytest.mark.slow
def test_directory_of_the_same_name_harms_nobody(tmp_path: Path) -> None:
    """Without Python in it, it is no package, and ours is found; a search needs neither."""
    (tmp_path / "analysis").mkdir()
    told = python("-m", "tacevo", "show", "nowhere", cwd=tmp_path)
    assert "nowhere: expected the directory or bundle of a run" in told.stderr
    (tmp_path / "analysis" / "__init__.py").write_text("raise SystemExit('I was run')\n")
    assert 'seed: expected an integer; got "x"' in python("-m", "tacevo", "search", "seed=x", cwd=tmp_path).stderr


@pytest.mark.parametrize(
    ("encoding", "shown"), [("ascii", rb"Gr\xf6\xdfe, \u89e6"), ("latin-1", b"Gr\xf6\xdfe, \\u89e6")]
)
def test_any_text_is_printed_in_any_encoding(
    encoding: str, shown: bytes, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Letters that the encoding lacks are escaped, and so is a name that is not text."""
    (run / "NOTE.md").write_text("Größe, 触覚", encoding="utf-8")
    for stream in ("stdout", "stderr"):
        monkeypatch.setattr(sys, stream, io.TextIOWrapper(io.BytesIO(), encoding=encoding))
    assert main(["show", str(run)]) == 0
    assert main(["show", os.fsdecode(b"n\xf6")]) == 2
    assert shown in written(sys.stdout)
    assert written(sys.stderr).splitlines()[-1].startswith(rb"error: n\udcf6: ")


def written(stream: TextIO) -> bytes:
    """Return what was written to a stream of `test_any_text_is_printed_in_any_encoding`."""
    assert isinstance(stream, io.TextIOWrapper)
    assert isinstance(stream.buffer, io.BytesIO)
    stream.flush()
    return stream.buffer.getvalue()


@pytest.mark.few(1)
@pytest.mark.parametrize("command", ["search seed=1", "search -m experiment=demo seed=1,2", "study run=."])
def test_settings_are_not_read_without_assertions(command: str, tmp_path: Path) -> None:
    """Hydra reads functions and dictionaries by assertions: one line says so, and what reads no setting works."""
    told = python("-m", "tacevo", *command.split(), cwd=tmp_path, PYTHONOPTIMIZE="1")
    assert (told.returncode, told.stdout) == (2, "")
    assert told.stderr.startswith("error: PYTHONOPTIMIZE: ")
    assert told.stderr.count("\n") == 1
    assert python("-m", "tacevo", "--version", cwd=tmp_path, PYTHONOPTIMIZE="1").returncode == 0


def test_end_that_is_asked_for_in_a_destructor_comes(tmp_path: Path) -> None:
    """Python ignores what a destructor raises; the command ends all the same, and says nothing of it."""
    code = """
import os, signal, time
from tacevo.cli.edge import Terminated, edge

class Late:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)

try:
    with edge():
        Late()
        time.sleep(60)
except Terminated:
    print("ended")
"""
    done = python("-c", code, cwd=tmp_path)
    assert (done.stdout, done.stderr) == ("ended\n", "")


def test_other_fault_of_a_destructor_is_still_told() -> None:
    """What Python would print of it is printed."""
    told: list[object] = []
    error = ValueError("a fault")
    edge._interrupt_again(told.append, ignored := type("Ignored", (), {"exc_value": error}))
    assert told == [ignored]


def test_second_interruption_hides_nothing_that_the_first_one_says(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C twice, the second while processes are ended: what is kept is said all the same, and how to go on."""

    def interrupted(*_: object) -> None:
        try:
            with telling(lambda: True):
                raise KeyboardInterrupt
        finally:
            raise KeyboardInterrupt

    monkeypatch.setattr("tacevo.cli.inspect.examine", interrupted)
    assert main(["doctor"]) == 130
    assert "what was computed is kept" in capsys.readouterr().err


@pytest.mark.room("document")
@pytest.mark.few(1)
@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_command_that_is_ended_says_so(number: signal.Signals, status: int, bundle: Path, tmp_path: Path) -> None:
    """While it draws a paper: one line, and the status that a shell gives for the signal."""
    command = [sys.executable, "-P", "-m", "tacevo.cli.app", "report", "--latex", str(bundle), "-o", "paper"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True) as process:
        assert eventually(lambda: any((tmp_path / "paper").glob("*/*")), seconds=300)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == status
    assert errors.splitlines()[-1].startswith("interrupted; ")
    assert "Traceback" not in errors
