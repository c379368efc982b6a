"""Trackers, which mirror runs somewhere else: what `tracking.kind` chooses."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


class Mirror(Protocol):
    """The mirroring of some runs, which goes on while they are written."""

    def finish(self, timeout: float | None) -> str | None:
        """Take that no more lines come, and wait so many seconds for the end; None to wait as long as it takes.

        Returns:
            None, or one line that warns the user: it failed, or is not done.
        """
        ...


class Tracker(Protocol):
    """Mirrors runs and studies, and never stops them: what `tracking.kind=NAME` stands for.

    A tracker of your own is a frozen dataclass, so that equal ones are told apart by their settings. A field `uri` or
    `experiment` gets the setting of `tracking` of that name; each other field is a setting of its own,
    `parts.NAME.FIELD`.
    """

    def mirror(self, runs: Sequence[Path]) -> Mirror | None:
        """Start to mirror the directories of runs, of which the first may still be written; None to mirror nothing.

        It must not raise: what cannot be mirrored is told by `finish`.
        """
        ...

    def viewing(self) -> str:
        """Say in one line where the mirror is looked at; empty where there is nothing to look at."""
        ...


@dataclass(frozen=True, slots=True)
class Untracked:
    """Mirrors nothing."""

    def mirror(self, runs: Sequence[Path]) -> None:
        """Mirror nothing."""

    def viewing(self) -> str:
        """There is nothing to look at."""
        return ""
