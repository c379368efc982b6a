"""The tracker that mirrors runs into MLflow; MLflow itself is not imported here."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tacevo.environment import as_typed
from tacevo.tracking.params import viewing
from tacevo.tracking.process import Mirror


@dataclass(frozen=True, slots=True, kw_only=True)
class MLflow:
    """Mirrors runs into an MLflow store, by a process of its own (see `tacevo.parts.tracker.Tracker`)."""

    #: Of the store; empty for the one in MLFLOW_TRACKING_URI.
    uri: str
    experiment: str

    def mirror(self, runs: Sequence[Path]) -> Mirror:
        """Start the process that mirrors runs, one after the other."""
        first, *more = runs
        mirror = Mirror(first, uri=self.uri, experiment=self.experiment, more=more)
        mirror.start()
        return mirror

    def viewing(self) -> str:
        """Say which command or page shows the store."""
        return f"MLflow: {viewing(self.uri, as_typed('mlflow'))}"
