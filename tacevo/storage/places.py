"""Whether anything lies where a user says that a run or a sweep does, looked at before anything is read.

This imports nothing that takes long, and verifies no bundle: a mistyped name is answered at once.
"""

import difflib
import re
import shlex
from pathlib import Path

from tacevo.errors import RunError
from tacevo.storage.zipfiles import names_in
from tacevo.text import counted, listed

#: Exactly one member of each job's.
_OF_A_JOB = re.compile(r"sweep/([^/]+)/run\.json")


def check_place(path: Path) -> None:
    """Check that there is a file or a directory; or of `SWEEP/JOB` and `SWEEP.zip/JOB` such a job.

    Raises:
        RunError: there is none; of a job, the message has the nearest names.
    """
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
            remedy="`tacevo search` makes a run, and prints its name",
        )
    near = (difflib.get_close_matches(path.name, jobs, n=3) or jobs)[:3]
    expected = f"one of its {counted(len(jobs), 'job')}, such as {listed(near)}" if jobs else "a job that has begun"
    remedy = f"`tacevo show {shlex.quote(str(sweep))}` lists them"
    raise RunError(repr(path.name), place=str(sweep), expected=expected, remedy=remedy)
