"""Promise: a file is written whole or not at all, and what a killed writer left is removed, but from no living one."""

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from refusals import refused

from tacevo.errors import StoreError
from tacevo.storage.files import is_in_use, remove_leftovers, write_durably
from tacevo.storage.store import KINDS, Store, remove_leftovers_in_stores

#: Writes answers of 100,000 equal digits under one key, again and again.
WRITER = """
import sys
from pathlib import Path
from tacevo.storage.store import Store
store = Store(Path(sys.argv[1]), "shared")
for _ in range(30):
    store.write({"x": 1}, sys.argv[2] * 100_000)
"""

#: Begins to write a file, says so, and never comes to an end.
STOPPED_WRITER = """
import sys, time
from pathlib import Path
from tacevo.storage.store import write_durably
class Endless(str):
    def encode(self):
        print("writing", flush=True)
        time.sleep(1000)
write_durably(Path(sys.argv[1]), Endless())
"""


def test_sweep_takes_the_parts_of_the_dead_and_leaves_those_of_the_living(tmp_path: Path) -> None:
    """A file in the making goes when its writer was killed, not while it writes, and nothing else is touched."""
    Store(tmp_path, "things").write({"x": 1}, "one")
    writing = [sys.executable, "-c", STOPPED_WRITER, str(tmp_path / "things" / "aa" / "entry.json")]
    before = {path for path in tmp_path.rglob("*") if path.is_file()}
    foreign = tmp_path / "things" / ".somebody.part"
    foreign.write_text("mine")
    with subprocess.Popen(writing, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "writing\n"
        assert len(list(tmp_path.rglob(".entry.json.*.part"))) == 1
        remove_leftovers(tmp_path)
        assert len(list(tmp_path.rglob(".entry.json.*.part"))) == 1
        writer.kill()
    assert len(list(tmp_path.rglob(".entry.json.*.part"))) == 1
    remove_leftovers(tmp_path)
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == before | {foreign}


#: Dies while it writes an entry.
DYING_WRITER = """
import os, sys
from pathlib import Path
from tacevo.storage.store import Store
os.fsync = lambda _: os._exit(0)
Store(Path(sys.argv[1]), sys.argv[2]).write({"x": 1}, "one")
"""


@pytest.mark.parametrize("kind", KINDS)
def test_search_removes_what_was_left_of_an_entry(kind: str, tmp_path: Path) -> None:
    """Without a look at every entry, of which there may be a million."""
    subprocess.run([sys.executable, "-c", DYING_WRITER, str(tmp_path), kind], check=True)
    assert len(list(tmp_path.rglob("*.part"))) == 1
    remove_leftovers_in_stores(tmp_path)
    assert not list(tmp_path.rglob("*.part"))


#: Makes `flock` fail as where a file system has no locks, with the error that the environment names.
LOCKLESS = """
#include <errno.h>
#include <stdlib.h>
int flock(int file, int operation) {
    errno = atoi(getenv("LOCKLESS_ERROR"));
    return -1;
}
"""


@pytest.fixture(scope="module")
def lockless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a library that takes the locks from a process, where there is a compiler."""
    if shutil.which("cc") is None:
        pytest.skip("a file system without locks needs a C compiler")
    folder = tmp_path_factory.mktemp("lockless")
    (folder / "lockless.c").write_text(LOCKLESS)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", "lockless.so", "lockless.c"], cwd=folder, check=True)
    return folder / "lockless.so"


def without_locks(code: str, error: int, library: Path, folder: Path) -> str:
    """Run code with a directory as its argument, where `flock` fails; return the last line of its errors."""
    environment = {**os.environ, "LD_PRELOAD": str(library), "LOCKLESS_ERROR": str(error)}
    command = [sys.executable, "-c", code, str(folder)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else done.stderr.splitlines()[-1]


WRITE = "import sys, pathlib, tacevo.storage.store as s; s.write_durably(pathlib.Path(sys.argv[1]) / 'file', 'new')"

REMOVAL = "import sys, pathlib, tacevo.storage.store as s; s.remove_leftovers(pathlib.Path(sys.argv[1]))"


@pytest.mark.parametrize("error", [errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK])
def test_file_system_without_locks_is_written_to_and_never_swept(error: int, lockless: Path, tmp_path: Path) -> None:
    """Nobody knows there whether a file's writer lives, so it stays; what is written is whole all the same."""
    part = tmp_path / ".file.0123456789abcdef.part"
    part.write_text("{")
    assert without_locks(WRITE, error, lockless, tmp_path) == ""
    assert without_locks(REMOVAL, error, lockless, tmp_path) == ""
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {part.name: "{", "file": "new"}


def test_lock_that_fails_otherwise_stops_a_write(lockless: Path, tmp_path: Path) -> None:
    """A disk that cannot be read is not a file system without locks: the write is refused and leaves nothing."""
    assert "cannot be written: Input/output error" in without_locks(WRITE, errno.EIO, lockless, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_looking_whether_a_file_is_in_use_leaves_nothing_open(tmp_path: Path) -> None:
    """A process that waits looks many times."""
    (tmp_path / ".lock").touch()
    before = os.listdir("/proc/self/fd")
    assert not is_in_use(tmp_path / ".lock")
    assert not is_in_use(tmp_path / "missing")
    assert os.listdir("/proc/self/fd") == before


def test_failed_write_leaves_the_old_content_and_no_rest(tmp_path: Path) -> None:
    """A text that cannot be written to its end (here: half a surrogate pair) changes nothing."""
    path = tmp_path / "file"
    write_durably(path, "old")
    with pytest.raises(UnicodeEncodeError):
        write_durably(path, "new \ud800")
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]
    assert path.read_text(encoding="utf-8") == "old"


def test_two_processes_write_at_once(tmp_path: Path) -> None:
    """A reader sees the one answer or the other, always whole; endless sweeps take no file from a living writer."""
    writers = [subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path), digit]) for digit in "12"]
    store = Store(tmp_path, "shared")
    seen = set()
    while any(writer.poll() is None for writer in writers):
        seen.add(store.read({"x": 1}))
        remove_leftovers(tmp_path)
    assert [writer.returncode for writer in writers] == [0, 0]
    assert store.read({"x": 1}) in {"1" * 100_000, "2" * 100_000}
    assert seen <= {None, "1" * 100_000, "2" * 100_000}
    assert len(list(tmp_path.rglob("*.part"))) == 0


def test_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    """A file in the place of the store's directory is the user's to mend, and is left alone."""
    (tmp_path / "completions").write_text("mine")
    with refused(StoreError, got="cannot be written: Not a directory; what stood there is unchanged"):
        Store(tmp_path, "completions").write({"a": 1}, "one")
    assert (tmp_path / "completions").read_text() == "mine"
