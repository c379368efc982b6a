"""Promise: a run directory belongs to one process at a time, is written whole, and is refused where it is damaged."""

import fcntl
import hashlib
import json
import subprocess
import sys
import threading
import zipfile
from datetime import datetime
from pathlib import Path

import pytest
from checkout import PUBLISHED
from full_disks import largest_file
from ledger_lines import run_record
from refusals import refused

from tacevo import environment
from tacevo.costs import Spending
from tacevo.environment import PACKAGES, gpus, machine, versions
from tacevo.errors import RunError
from tacevo.records import Reason, Rejection, Stage, to_json, written
from tacevo.storage.run_directory import RunDirectory

#: Locks a run directory, says so, and waits until it is killed.
HOLDER = """
import sys
from pathlib import Path
from tacevo.storage.run_directory import RunDirectory
with RunDirectory(Path(sys.argv[1])).locked():
    print("locked", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def directory(tmp_path: Path) -> RunDirectory:
    """Return a run directory that is not made yet."""
    return RunDirectory(tmp_path / "runs" / "one")


def test_lock_makes_the_folder_and_excludes_others(directory: RunDirectory) -> None:
    """While one holds the directory another is refused; afterwards it may come."""
    with directory.locked():
        assert directory.path.is_dir()
        remedy = "wait for it, or choose another run.dir"
        with refused(RunError, got="another process in it", remedy=remedy), directory.locked():
            pass
    with directory.locked():
        pass


@pytest.mark.parametrize("above", [False, True])
def test_file_in_the_place_of_a_directory_is_to_be_moved(above: bool, tmp_path: Path) -> None:
    """Or in that of one above it; nothing else would help."""
    (tmp_path / "run").write_text("mine")
    path = tmp_path / "run" / "deep" if above else tmp_path / "run"
    with refused(RunError, place=f"run.dir={path}", remedy="move away"), RunDirectory(path).locked():
        pytest.fail("it is locked")


def test_who_looks_for_a_moment_keeps_nobody_out(directory: RunDirectory) -> None:
    """To see whether a directory is held takes a lock itself, and a run that begins just then waits for its end."""
    directory.path.mkdir(parents=True)
    with (directory.path / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        end = threading.Timer(0.2, fcntl.flock, (lock, fcntl.LOCK_UN))
        end.start()
        with directory.locked():
            assert directory.is_busy
        end.join()


def test_killed_process_lets_go_of_the_lock(directory: RunDirectory) -> None:
    """A lock dies with its process, so that a killed run can be resumed."""
    command = [sys.executable, "-c", HOLDER, str(directory.path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "locked\n"
        with refused(RunError, got="another process in it"), directory.locked():
            pass
        holder.kill()
        holder.wait()
    with directory.locked():
        pass


def test_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    """The message names the setting that chose it."""
    (tmp_path / "file").write_text("", encoding="utf-8")
    directory = RunDirectory(tmp_path / "file/run")
    with (
        refused(RunError, place="run.dir=", expected="can be written to", got="one that cannot (Not a directory)"),
        directory.locked(),
    ):
        pass


@pytest.mark.parametrize("bundle", sorted(PUBLISHED.glob("*.zip")), ids=lambda path: path.stem)
def test_published_run_json_comes_back(bundle: Path, tmp_path: Path) -> None:
    """What later releases added is at its default, and all else is as it was written."""
    with zipfile.ZipFile(bundle) as members:
        text = next(members.read(name) for name in members.namelist() if name.endswith("/run.json"))
    (tmp_path / "run.json").write_bytes(text)
    written = json.loads(text)
    assert {**to_json(RunDirectory(tmp_path).read_run()), **written} == {
        "code": None,
        "pages": 1,
        **written,
    }


def test_directory_without_a_run_is_an_error(directory: RunDirectory, tmp_path: Path) -> None:
    """One that is not there; a published run is not called damaged, but told what to give instead."""
    with refused(RunError, place=str(directory.path), expected="the directory of a run"):
        directory.read_run()
    (tmp_path / "run.zip").write_bytes(b"PK")
    with refused(RunError, place="run.zip", got="a file", remedy="unzip a published run"):
        RunDirectory(tmp_path / "run.zip").read_run()


#: Machine and configuration are free JSON, whose reader lets NaN through; no file of ours could hold it again.
NAN = json.dumps({**written(run_record()), "machine": {"cpu": float("nan")}})


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", "null", "\x00", '{"schema": 2}', NAN])
def test_damaged_run_is_an_error(content: str, directory: RunDirectory) -> None:
    """Whatever run.json holds instead, the message names the file and what writes it again."""
    directory.write_text("run.json", content)
    with refused(RunError, place="run.json", remedy="`tacevo search` command that began the run writes it again"):
        directory.read_run()


def test_nan_is_refused(directory: RunDirectory) -> None:
    """No JSON file of a run holds NaN, and the file before it stays."""
    directory.write_json("archive.json", {"qd_score": 1.0})
    with pytest.raises(ValueError, match="not JSON compliant"):
        directory.write_json("archive.json", {"qd_score": float("nan")})
    assert json.loads((directory.path / "archive.json").read_text(encoding="utf-8")) == {"qd_score": 1.0}


def test_source_is_what_was_admitted(directory: RunDirectory) -> None:
    """One that was edited, or whose file is gone, is refused by its name."""
    source = "class A: ...\n"
    digest = hashlib.sha256(source.encode()).hexdigest()
    directory.keep_candidate("g00s01", source)
    assert directory.read_source("g00s01", digest) == source
    directory.keep_candidate("g00s01", source + "# better\n")
    for name, got in (("g00s01", "another source: the file was edited"), ("g00s02", "no file")):
        with refused(RunError, place=f"candidates/{name}.py", got=got, remedy="restore it"):
            directory.read_source(name, digest)


def test_file_that_a_killed_run_left_is_replaced(directory: RunDirectory) -> None:
    """Another answer may come into a slot that was developed but never committed; one file of it remains.

    What stands there is not written again.
    """
    directory.keep_rejected("g00s01", Rejection(stage=Stage.extract, reason=Reason.empty, detail="blank"), "")
    directory.keep_candidate("g00s01", "class A: ...\n")
    directory.keep_candidate("g00s01", "class B: ...\n")
    before = (directory.path / "candidates/g00s01.py").stat().st_mtime_ns
    directory.keep_candidate("g00s01", "class B: ...\n")
    assert (directory.path / "candidates/g00s01.py").stat().st_mtime_ns == before
    assert [path.name for path in (directory.path / "candidates").iterdir()] == ["g00s01.py"]
    assert directory.read_kept("g00s01") == b"class B: ...\n"
    assert directory.read_kept("g00s02") is None


def test_rejected_answer_is_kept_under_its_reason(directory: RunDirectory) -> None:
    """A rejected candidate's file begins with stage, reason and detail, and holds the raw answer."""
    rejection = Rejection(stage=Stage.extract, reason=Reason.no_class, detail="prose only")
    directory.keep_rejected("g00s01", rejection, "I would widen it.")
    text = (directory.path / "candidates/g00s01.rejected.txt").read_text(encoding="utf-8")
    assert text.splitlines()[0] == "extract: no_class: prose only"
    assert text.endswith("\nI would widen it.\n")


def test_timings_are_appended_with_their_moment(directory: RunDirectory) -> None:
    """Each line has a time with its zone."""
    directory.path.mkdir(parents=True)
    directory.add_timing(Spending(), id="g00s00", seconds=1.5)
    directory.add_timing(Spending(answers=1), generation=0)
    assert len((directory.path / "timings.jsonl").read_text().splitlines()) == 2
    first, second = directory.read_timings()
    assert (first.id, first.seconds, second.generation, second.spent) == ("g00s00", 1.5, 0, Spending(answers=1))
    assert all(datetime.fromisoformat(line.at).tzinfo is not None for line in (first, second))


def test_full_disk_costs_no_line_that_was_written(directory: RunDirectory) -> None:
    """The message names the file and what to do; what a part of a line left is passed over."""
    directory.path.mkdir(parents=True)
    directory.add_timing(Spending(), id="g00s00")
    room = (directory.path / "timings.jsonl").stat().st_size + 10
    with largest_file(room), refused(RunError, place="timings.jsonl", got="the ledger is safe", remedy="make room"):
        directory.add_timing(Spending(), id="g00s01")
    directory.add_timing(Spending(), id="g00s02")
    assert list(directory.read_spending()) == ["g00s00", "g00s02"]


def test_versions_name_every_package_and_the_machine_without_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python and each package that matters; a reader sees that one that is not there was looked for."""
    assert set(machine()) == {"cpu", "cores", "architecture", "system", "libc", "gpu"}
    assert set(versions()) == {"python", *PACKAGES}
    assert versions()["numpy"] != "absent"
    monkeypatch.setattr(environment, "PACKAGES", ("no-such-package",))
    assert versions()["no-such-package"] == "absent"


def test_gpu_is_named_as_its_driver_does(tmp_path: Path) -> None:
    """The first card's model, without its serial number; none where no driver lists any."""
    assert gpus(tmp_path / "absent") == []
    card = tmp_path / "0000:01:00.0" / "information"
    card.parent.mkdir()
    card.write_text("Model: \t\t NVIDIA H100 80GB HBM3\nIRQ:   \t\t 17\nGPU UUID: \t GPU-1234\n", encoding="utf-8")
    assert gpus(tmp_path) == ["NVIDIA H100 80GB HBM3"]


def test_spending_is_read_by_candidate_and_the_last_line_counts(directory: RunDirectory) -> None:
    """Lines of generations are passed over, and so is what a kill tore; the line after a torn one is whole."""
    assert directory.read_spending() == {}
    directory.path.mkdir(parents=True)
    directory.add_timing(Spending(answers=1, usd=0.5), id="g00s01")
    directory.add_timing(Spending(answers=9), generation=0)
    with (directory.path / "timings.jsonl").open("a") as file:
        file.write('{"id": "g00s02", "ans')
    directory.add_timing(Spending(answers=2, usd=0.75), id="g00s01")
    assert directory.read_spending() == {"g00s01": Spending(answers=2, usd=0.75)}


def test_link_in_a_strangers_run_is_not_followed(tmp_path: Path) -> None:
    """Else a page of that run would show a file of its reader."""
    own = tmp_path / "secret.txt"
    own.write_text("mine")
    (tmp_path / "run" / "candidates").mkdir(parents=True)
    (tmp_path / "run" / "candidates" / "g00s01.rejected.txt").symlink_to(own)
    assert RunDirectory(tmp_path / "run").read_kept("g00s01") is None
