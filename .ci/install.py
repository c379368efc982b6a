"""Run `pip install` with the given arguments, and say in one line, which moves, how far it is.

    python .ci/install.py --requirement requirements.lock

Pip itself says nothing while it unpacks, which takes most of the time. What it ends with, an error above all, is shown.
"""

import re
import subprocess
import sys
import sysconfig
import threading
import time
from pathlib import Path

#: Seconds from one line to the next: on a terminal they overwrite each other.
PAUSE = 0.5 if sys.stderr.isatty() else 4.0


class Pip:
    """A pip at work, and what it said so far."""

    def __init__(self, arguments: list[str]) -> None:
        command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--progress-bar", "off"]
        self._process = subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, text=True)
        self._site = Path(sysconfig.get_path("purelib"))
        self._began, self._before = time.monotonic(), self._installed()
        self._fetched, self._total, self.last = 0, 0, ""
        threading.Thread(target=self._read, daemon=True).start()

    def _installed(self) -> int:
        return len(list(self._site.glob("*.dist-info")))

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.last = line.strip() or self.last
            if re.match(r"Collecting |Obtaining |Processing ", self.last):
                self._fetched += 1
            if self.last.startswith("Installing collected packages:"):
                self._total = self.last.count(",") + 1

    def wait(self, seconds: float) -> int | None:
        """Wait for its end, but not longer; return its exit status, None while it works."""
        try:
            return self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return None

    def standing(self) -> str:
        """Say how far it is."""
        took = f"{time.monotonic() - self._began:.0f} s"
        if self._total:
            return f"{took}: {self._installed() - self._before} of {self._total} packages installed"
        return f"{took}: {self._fetched} packages fetched; {self.last}"


def main(arguments: list[str]) -> int:
    """Install, and show how far it is; return the exit status of pip."""
    pip, over = Pip(arguments), "\r\x1b[K" if sys.stderr.isatty() else "\n"
    while (status := pip.wait(PAUSE)) is None:
        print(f"{over}{pip.standing()[:78]}", end="", file=sys.stderr, flush=True)
    print(f"{over}{pip.last[:78] if status else pip.standing()}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
