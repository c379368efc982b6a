"""Whether anything lies where a user says that a run or a sweep does, looked at before anything is read.

This imports nothing that takes long, and verifies no bundle: a mistyped name is answered at once.
"""

import contextlib
import difflib
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

from tacevo.errors import RunError
from tacevo.storage.zipfiles import names_in
from tacevo.text import counted, listed, nearest

#: Exactly one member of each job's.
_OF_A_JOB = re.compile(r"sweep/([^/]+)/run\.json")

#: Where runs, sweeps and published bundles lie unless the user says otherwise.
_USUAL = ("runs", "sweeps", "cache/published")

#: The files of which a directory of a run or a sweep has one.
_RECORDS = ("run.json", "sweep.json")

#: Lies in the directory of an unpacked bundle (`tacevo.storage.run_directory.MANIFEST`, whose module takes longer).
_UNPACKED = "manifest-sha256.txt"

#: How many names a message lists.
_MOST = 3


def check_place(path: Path) -> None:
    """Check that there is a file or a directory; or of `SWEEP/JOB` and `SWEEP.zip/JOB` such a job.

    Raises:
        RunError: there is none, or a directory that only holds runs; the message has the nearest names.
    """
    if path.is_dir() and not _is_one(path) and (held := list(_held(path))):
        remedy = f"name one, as in {shlex.quote(str(path / held[0]))}"
        got = f"a directory that holds {listed(held, most=_MOST)}"
        raise RunError(got, place=str(path), expected="the directory or bundle of a run or a sweep", remedy=remedy)
    if path.exists():
        return
    sweep = path.parent
    if sweep.is_file():
        names = names_in(sweep)
        if names is None:  # its reader says why
            return
        jobs = [match[1] for name in names if (match := _OF_A_JOB.fullmatch(name))]
        if path.name in jobs:
            return
        if not jobs:
            raise RunError("one run", place=str(sweep), expected="the bundle of a sweep", remedy="name the file alone")
    elif (sweep / "sweep.json").exists():
        jobs = [each.parent.name for each in sorted(sweep.glob("*/run.json"))]
    else:
        raise RunError(
            "a path that does not exist",
            place=str(path),
            expected="the directory or bundle of a run or a sweep",
            remedy=meant(path) or "`tacevo search` makes a run, and prints its name",
        )
    near = (difflib.get_close_matches(path.name, jobs, n=_MOST) or jobs)[:_MOST]
    expected = f"one of its {counted(len(jobs), 'job')}, such as {listed(near)}" if jobs else "a job that has begun"
    remedy = f"`tacevo show {shlex.quote(str(sweep))}` lists them"
    raise RunError(repr(path.name), place=str(sweep), expected=expected, remedy=remedy)


def _is_one(path: Path) -> bool:
    """Answer whether a directory is a run's, a sweep's, a study's or an unpacked bundle's, of which its reader says."""
    return any((path / name).exists() for name in (*_RECORDS, "ledger.jsonl", "study.json", _UNPACKED))


def _held(folder: Path) -> Iterator[str]:
    """Yield the names of the runs, sweeps and bundles that lie in a directory, in order; none where it is not read."""
    with contextlib.suppress(OSError):
        for path in sorted(folder.iterdir()):
            if path.suffix == ".zip" or any((path / name).exists() for name in _RECORDS):
                yield path.name


def check_sweep(path: Path) -> None:
    """Check that there may be a sweep.

    Raises:
        RunError: as `check_place`, or it is a run.
    """
    check_place(path)
    if (path / "run.json").exists():
        remedy = "a run has no arms; `tacevo tables` and `tacevo report` take one"
        raise RunError("that of a run", place=str(path), expected="the directory or bundle of a sweep", remedy=remedy)


def sibling(path: Path, otherwise: str = "") -> str:
    """Ask whether another file or directory beside a path that is not there was meant; else say something else."""
    names = []
    with contextlib.suppress(OSError):
        names = [each.name for each in path.parent.iterdir()]
    return nearest(path.name, names, otherwise, before="" if path.parent == Path() else f"{path.parent}/")


def meant(path: Path) -> str:
    """Ask whether a run, sweep or bundle of such a name was meant, here or where they usually lie; empty where none is.

    A name is compared as it was typed, then with its ending, and then by its letters.
    """
    known = {
        str(folder / name): name
        for folder in dict.fromkeys([path.parent, *map(Path, _USUAL)])
        for name in _held(folder)
    }
    same = [place for place, name in known.items() if name in {path.name, f"{path.name}.zip"}]
    close = difflib.get_close_matches(path.name, known.values(), n=_MOST)
    near = same or [place for place, name in known.items() if name in close]
    return f"did you mean {' or '.join(near[:_MOST])}?" if near else ""
