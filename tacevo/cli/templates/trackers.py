"""Trackers: where runs are mirrored."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tacevo.parts.tracker import Mirror, Tracker


@dataclass(frozen=True)
class Mine(Tracker):
    """Copies the ledger of each run into a directory."""

    folder: str = "mirrored"

    def mirror(self, runs: Sequence[Path]) -> Mirror:
        """Start to mirror runs, of which the first may still be written; this must not raise."""
        return _Copying(runs, Path(self.folder))

    def viewing(self) -> str:
        """Say in one line where to look."""
        return f"ledgers: {self.folder}"


@dataclass(frozen=True)
class _Copying(Mirror):
    runs: Sequence[Path]
    folder: Path

    def finish(self, timeout: float | None) -> str | None:
        """Copy what is there now; return what went wrong in one line."""
        try:
            for ledger in [run / "ledger.jsonl" for run in self.runs if (run / "ledger.jsonl").exists()]:
                self.folder.mkdir(parents=True, exist_ok=True)
                shutil.copy(ledger, self.folder / f"{ledger.parent.name}.jsonl")
        except OSError as error:
            return f"not mirrored: {error}"
        return None
