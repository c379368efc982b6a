"""Promise: the benchmark's synthetic run is a sound run."""

import io
from pathlib import Path

import pytest
from rich.console import Console

from benchmarks.synthetic import record_synthetic
from tacevo.cli.app import main
from tacevo.runs.progress import Progress


@pytest.mark.slow  # `make bench-quick` runs the benchmark itself
def test_synthetic_run_can_be_replayed(tmp_path: Path) -> None:
    """Its run.json and its ledger state the same data set."""
    record_synthetic(tmp_path, 0, Progress(Console(file=io.StringIO())))
    assert main(["replay", str(tmp_path / "run")]) == 0
