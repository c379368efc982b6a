"""The `tacevo` command in a process of its own."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

#: The name of the directory that hides rooms in each process that finds it (`hiding`) begins so.
HIDES = "tacevo-hidden-"

_RUN = "import sys; from tacevo.cli.app import main; sys.exit(main(sys.argv[1:]))"


def tacevo(
    *arguments: str | Path,
    cwd: Path | None = None,
    status: int = 0,
    before: str = "",
    path: Sequence[str] | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run the command to its end, after other statements, and expect its exit status and no traceback.

    `path` is where modules are found, if not where this process finds them.
    """
    done = subprocess.run(
        [sys.executable, "-c", f"{before}\n{_RUN}", *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path if path is None else path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr
    return done


def publish(*arguments: str | Path, cwd: Path | None = None) -> None:
    """Publish what a test then reads; where rooms are hidden, in a process that has them, because it needs several."""
    from tacevo.cli.app import main

    with_rooms = [each for each in sys.path if HIDES not in each]
    if cwd is not None or with_rooms != sys.path:
        tacevo("publish", *arguments, cwd=cwd, path=with_rooms)
    else:
        assert main(["publish", *map(str, arguments)]) == 0
