"""The shipped settings load the real recordings: 3,000 TacTip images with poses, 1,000 GelSight images of materials."""

import csv
from pathlib import Path

import numpy as np
import pytest
from checkout import ROOT, SHARED

from tacevo.config.compose import compose
from tacevo.config.schema import RunConfig
from tacevo.config.task_texts import load_task
from tacevo.data.dataset import Dataset
from tacevo.runs.datasets import load_data
from tacevo.runs.progress import Progress

#: One file of overrides for each recording; where it lies is said on the command line.
SETTINGS = ROOT / "tests" / "recordings"
RECORDINGS = SHARED / "data"

needs_recordings = pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason=f"the real recordings are not part of the project and not in {RECORDINGS}"
)


def composed(name: str, *overrides: str) -> RunConfig:
    """Compose the settings of a recording with what the command line adds."""
    return compose([*(SETTINGS / f"{name}.txt").read_text().splitlines(), *overrides])


def load(name: str, folder: str, cache: Path) -> Dataset:
    """Load a recording as a search does."""
    return load_data(composed(name, f"data.root={RECORDINGS / folder}", f"store.root={cache}"), Progress())


@pytest.mark.parametrize("name", sorted(path.stem for path in SETTINGS.iterdir()))
def test_settings_compose_wherever_the_recording_lies(name: str) -> None:
    """Every file of settings needs nothing but the root."""
    config = composed(name, "data.root=somewhere")
    assert (config.data.root, config.data.image_size) == ("somewhere", 64)


@pytest.mark.slow
@needs_recordings
def test_tactip_poses_are_loaded(tmp_path: Path) -> None:
    """All rows arrive, with the labels of the table in their ranges and images that show something."""
    dataset = load("tactip", "tactip_surface", tmp_path)
    assert dataset.facts.counts == (2_400, 300, 300)
    assert dataset.facts.names == ("depth_mm", "roll_deg", "pitch_deg")
    with (RECORDINGS / "tactip_surface" / "labels.csv").open(newline="") as file:
        rows = [[float(row[name]) for name in dataset.facts.names] for row in csv.DictReader(file)]
    labels = dataset.targets * np.array(dataset.scale) + np.array(dataset.offset)
    assert labels == pytest.approx(np.array(rows), abs=1e-4)
    assert labels.min(axis=0) == pytest.approx([2.5, -15, -15], abs=0.1)
    assert labels.max(axis=0) == pytest.approx([5.5, 15, 15], abs=0.1)
    assert min(dataset.deviation) > 20
    assert load_task(composed("tactip", "data.root=x"), dataset.facts).contract.outputs == 3


@pytest.mark.slow
@needs_recordings
def test_gelsight_materials_are_loaded(tmp_path: Path) -> None:
    """Ten classes of 100 images arrive in the order of their numbers."""
    dataset = load("gelsight", "gelsight_materials", tmp_path)
    assert dataset.facts.counts == (800, 100, 100)
    assert dataset.facts.names == tuple(f"{number:02d}" for number in range(1, 11))
    assert np.bincount(dataset.targets).tolist() == [100] * 10
    assert (dataset.offset, dataset.scale) == ((), ())
    assert min(dataset.deviation) > 5
    assert load_task(composed("gelsight", "data.root=x"), dataset.facts).contract.outputs == 10


@pytest.mark.slow
@needs_recordings
@pytest.mark.parametrize(("name", "folder"), [("tactip", "tactip_surface"), ("gelsight", "gelsight_materials")])
def test_fingerprint_is_stable(tmp_path: Path, name: str, folder: str) -> None:
    """Made twice from the files, and read from the cache, a recording is one data set."""
    first, cached, again = (load(name, folder, tmp_path / cache) for cache in ("one", "one", "two"))
    assert (first.facts, first.images) == (cached.facts, cached.images)
    assert again.facts == first.facts
    assert again.images != first.images
