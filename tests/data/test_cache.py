"""The cache of data sets: an entry is whole or absent after kills, simultaneous starts and full disks."""

import fcntl
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from checkout import ROOT
from greys import Greys, entries
from small_recordings import loaded

from tacevo.data.staging import LOCK

LOAD_IN_A_PROCESS = """
import os, resource, signal, sys
from pathlib import Path
from tests_own import Touches

from tacevo.choices import Normalisation, TargetScaling
from tacevo.data.loading import load
from tacevo.errors import DataError

cache, fate, seed = sys.argv[1:]

told = []

def progress(done, total):
    told.append(done)
    if fate == "die" and done > total / 2:
        os.kill(os.getpid(), signal.SIGKILL)

soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
if fate == "limited":
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
source = Touches(images=300, image_size=16, seed=int(seed))
try:
    dataset = load(source, split_seed=0, normalisation=Normalisation.unit, target_scaling=TargetScaling.minmax,
                   cache=Path(cache), workers=1, progress=progress)
except DataError as error:
    sys.exit(f"error: {error}")
finally:
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))  # `make coverage` writes more at the end
print(dataset.facts.fingerprint)
print("made" if told else "found", file=sys.stderr)
"""


def start(cache: Path, fate: str, *, seed: int = 0, before: tuple[str, ...] = ()) -> subprocess.Popen[str]:
    """Start a process that loads a data set, dies half-way, or may write little to a file."""
    command = [*before, sys.executable, "-c", LOAD_IN_A_PROCESS, str(cache), fate, str(seed)]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def unfinished(cache: Path) -> list[Path]:
    """List the hidden directories, which hold images in the making."""
    return [path for path in cache.iterdir() if path.name.startswith(".") and path.is_dir()]


@pytest.mark.slow
def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    """After a kill half-way the entry is absent; the next process, for another data set, clears the rest away."""
    killed = start(tmp_path, "die")
    killed.communicate()
    assert killed.returncode == -9
    assert entries(tmp_path) == []
    assert len(unfinished(tmp_path)) == 1
    output, _ = start(tmp_path, "live", seed=1).communicate()
    assert len(output.strip()) == 64
    assert len(entries(tmp_path)) == 1
    assert unfinished(tmp_path) == []


def test_processes_that_start_at_once_share_one_entry(tmp_path: Path) -> None:
    """All finish, with the same data, of which only one has made a picture, and one entry remains."""
    started = [start(tmp_path, "live") for _ in range(3)]
    outputs, told = zip(*[process.communicate() for process in started], strict=True)
    assert len(set(outputs)) == 1
    assert len(outputs[0].strip()) == 64
    assert sorted(told) == ["found\n", "found\n", "made\n"]
    assert len(entries(tmp_path)) == 1
    assert unfinished(tmp_path) == []


def test_who_waits_for_another_process_says_so(tmp_path: Path) -> None:
    """One line, before the wait, so that it does not look like a hang; and one before images are made, none after."""
    said: list[str] = []
    folder = loaded(Greys(), tmp_path, say=said.append).images.parent
    loaded(Greys(), tmp_path, say=said.append)
    assert [line.partition(" images")[0].rpartition(" ")[0] for line in said] == ["data: preparing"]
    shutil.rmtree(folder)
    with (tmp_path / f".{folder.name}{LOCK}").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)

        def say(text: str) -> None:
            said.append(text)
            fcntl.flock(lock, fcntl.LOCK_UN)  # else the test would wait for ever

        loaded(Greys(), tmp_path, say=say)
    assert said[1] == "data: another process makes this data set; waiting for it"


@pytest.mark.slow
def test_process_that_finds_a_killed_one_while_others_start_is_safe(tmp_path: Path) -> None:
    """Two data sets made at once after a kill: neither takes the other's unfinished directory for a leftover."""
    start(tmp_path, "die").communicate()
    started = [start(tmp_path, "live", seed=seed) for seed in (0, 1, 0, 1)]
    outputs = [process.communicate()[0] for process in started]
    assert outputs[0] == outputs[2] != outputs[1] == outputs[3]
    assert len(entries(tmp_path)) == 2
    assert unfinished(tmp_path) == []


NO_ROOM = r"error: {cache}: expected 230,528 free bytes for the images; got .*; make room there, .*\n"


def test_file_that_may_not_grow_is_refused(tmp_path: Path) -> None:
    """A limit of 100 kB for a file of 230 kB: the room is asked for before anything is written."""
    process = start(tmp_path, "limited")
    _, message = process.communicate()
    assert process.returncode == 1
    assert re.fullmatch(NO_ROOM.format(cache=tmp_path), message)
    assert entries(tmp_path) == []
    assert unfinished(tmp_path) == []


#: Runs a command with a disk of 128 kB in place of a directory, which only it sees, and lists what is left on it.
SMALL_DISK = (
    'mount -t tmpfs -o size=128k tmpfs "$0" && { "$@"; status=$?; find "$0" -mindepth 1 -type d; exit $status; }'
)


def test_full_disk_is_refused_and_left_clean(tmp_path: Path) -> None:
    """A disk of 128 kB: a clear line instead of the bus error that a memory map dies of, and no directory left."""
    private = ("unshare", "--user", "--map-root-user", "--mount", "sh", "-c")
    if subprocess.run([*private, SMALL_DISK, str(tmp_path), "true"], capture_output=True, check=False).returncode:
        pytest.skip("this machine lets no test mount a disk")
    process = start(tmp_path, "live", before=(*private, SMALL_DISK, str(tmp_path)))
    left, message = process.communicate()
    assert left == ""
    assert process.returncode == 1
    assert re.fullmatch(NO_ROOM.format(cache=tmp_path), message)
