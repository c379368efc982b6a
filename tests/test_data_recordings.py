"""The loaders on real recordings: 3,000 TacTip images with poses, 1,000 GelSight images of ten materials."""

import csv
from pathlib import Path

import numpy as np
import pytest

from tacevo.choices import Normalisation, TargetScaling
from tacevo.data.dataset import Dataset, fingerprint
from tacevo.data.folder import Folder
from tacevo.data.loading import load
from tacevo.data.source import Source
from tacevo.data.table import Table

RECORDINGS = Path(__file__).parent.parent.parent / "shared" / "data"

pytestmark = pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason=f"the real recordings are not part of the project and not in {RECORDINGS}"
)

TACTIP = Table(
    root=RECORDINGS / "tactip_surface",
    table="labels.csv",
    image_column="image",
    target_columns=("depth_mm", "roll_deg", "pitch_deg"),
    image_size=32,
)
GELSIGHT = Folder(root=RECORDINGS / "gelsight_materials", image_size=32)


def load_recording(source: Source, cache: Path) -> Dataset:
    """Load with the default protocol."""
    return load(
        source,
        split_seed=0,
        normalisation=Normalisation.standardise,
        target_scaling=TargetScaling.minmax,
        cache=cache,
        workers=1,
    )


def test_tactip_poses_are_loaded(tmp_path: Path) -> None:
    """All rows arrive, with the labels of the table and images that show something."""
    dataset = load_recording(TACTIP, tmp_path)
    assert dataset.facts.counts == (2_400, 300, 300)
    assert dataset.facts.names == ("depth_mm", "roll_deg", "pitch_deg")
    with (TACTIP.root / TACTIP.table).open(newline="") as file:
        row = list(csv.DictReader(file))[1_234]
    restored = dataset.targets[1_234] * np.array(dataset.scale) + np.array(dataset.offset)
    assert restored == pytest.approx([float(row[name]) for name in TACTIP.target_columns], abs=1e-4)
    assert min(dataset.deviation) > 20
    assert dataset.facts.fingerprint == fingerprint(dataset)


def test_tactip_is_cached_by_content(tmp_path: Path) -> None:
    """A second load gives the same data set from the same place."""
    first, second = load_recording(TACTIP, tmp_path), load_recording(TACTIP, tmp_path)
    assert (first.facts, first.images) == (second.facts, second.images)


def test_gelsight_materials_are_loaded(tmp_path: Path) -> None:
    """Ten classes of 100 images arrive in the order of their numbers."""
    dataset = load_recording(GELSIGHT, tmp_path)
    assert dataset.facts.counts == (800, 100, 100)
    assert dataset.facts.names == tuple(f"{number:02d}" for number in range(1, 11))
    assert np.bincount(dataset.targets).tolist() == [100] * 10
    assert (dataset.offset, dataset.scale) == ((), ())
    assert min(dataset.deviation) > 5
