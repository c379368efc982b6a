"""Promise: no test image or label influences which networks a search finds."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from smallest import SMALLEST, UNTRACKED

from tacevo.cli.app import main
from tacevo.config.compose import compose
from tacevo.records import written
from tacevo.runs.datasets import load_data
from tacevo.runs.progress import Progress
from tacevo.search.files import read_ledger
from tacevo.storage.run_directory import RunDirectory

TINY = [*SMALLEST, UNTRACKED, "search.generations=0", "search.initial=2"]


def test_selection_never_sees_the_test_images(place: Path) -> None:
    """Two data sets that differ in all test images and labels give one search, but for what names the data."""
    rng = np.random.default_rng(0)
    images, labels = rng.integers(0, 256, (40, 16, 16, 3), dtype=np.uint8), rng.random((40, 3))
    np.savez("a.npz", images=images, labels=labels, names=["Fx", "Fy", "Fz"])
    numpy = [*TINY, "data=numpy", "data.image_size=16", "archive.niches=5"]
    rows = load_data(compose([*numpy, "data.root=a.npz"]), Progress()).test
    images[rows], labels[rows] = 255 - images[rows], labels[rows] + 1
    np.savez("b.npz", images=images, labels=labels, names=["Fx", "Fy", "Fz"])
    decisions = []
    for name in ("a", "b"):
        assert main(["search", *numpy, f"data.root={name}.npz", f"run.dir={name}"]) == 0
        header: Any
        header, *lines = map(written, read_ledger(RunDirectory(place / name)).lines)
        del header["data"]["fingerprint"]
        decisions.append([header["data"], *({**line, "evaluation": None} for line in lines)])  # its key holds it, too
    first, second = (json.loads((place / name / "run.json").read_text())["data"] for name in ("a", "b"))
    assert first["fingerprint"] != second["fingerprint"]
    assert len(rows) == 4
    assert decisions[0] == decisions[1]
    assert (place / "a" / "archive.json").read_text() == (place / "b" / "archive.json").read_text()
