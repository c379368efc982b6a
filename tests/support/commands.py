"""The `tacevo` command in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

_RUN = "import sys; from tacevo.cli.app import main; sys.exit(main(sys.argv[1:]))"


def tacevo(
    *arguments: str | Path, cwd: Path | None = None, status: int = 0, before: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run the command to its end, after other statements, and expect its exit status and no traceback."""
    done = subprocess.run(
        [sys.executable, "-c", f"{before}\n{_RUN}", *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr
    return done
