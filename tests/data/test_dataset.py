"""A data set on disk: it comes back unchanged, and everything that training can see changes its fingerprint."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

from tacevo.data.dataset import ARRAYS, STATISTICS, Dataset, fingerprint, read, with_fingerprint, write
from tacevo.errors import DataError
from tacevo.records import DataFacts, Kind


def make(folder: Path) -> Dataset:
    """Make a data set of ten tiny images."""
    folder.mkdir(exist_ok=True)
    images = np.arange(10 * 3 * 4, dtype=np.uint8).reshape(10, 3, 2, 2)
    np.save(folder / "images.npy", images)
    facts = DataFacts(
        fingerprint="",
        kind=Kind.regression,
        counts=(8, 1, 1),
        in_channels=3,
        image_size=2,
        outputs=2,
        names=("depth", "roll"),
    )
    rows = np.arange(10)
    unsigned = Dataset(
        facts=facts,
        images=(folder / "images.npy").resolve(),
        targets=np.linspace(0, 1, 20, dtype=np.float32).reshape(10, 2),
        train=rows[:8],
        validation=rows[8:9],
        test=rows[9:],
        mean=(1.0, 2.0, 3.0),
        deviation=(4.0, 5.0, 6.0),
        offset=(0.0, 0.5),
        scale=(1.0, 2.0),
    )
    return with_fingerprint(unsigned)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    """Facts, statistics and arrays survive, with their types."""
    before = make(tmp_path)
    write(before, tmp_path)
    after = read(tmp_path)
    assert (after.facts, after.images) == (before.facts, before.images)
    for name in STATISTICS:
        assert getattr(after, name) == getattr(before, name)
    for name in ARRAYS:
        assert np.array_equal(getattr(after, name), getattr(before, name))
        assert getattr(after, name).dtype == getattr(before, name).dtype


def test_fingerprint_can_be_checked_afterwards(tmp_path: Path) -> None:
    """It does not depend on itself, nor on the directory of the images."""
    here, there = make(tmp_path / "here"), make(tmp_path / "there")
    assert here.facts.fingerprint == there.facts.fingerprint == fingerprint(here)
    assert len(here.facts.fingerprint) == 64


@pytest.mark.parametrize("name", [*ARRAYS, *STATISTICS, "names", "images"])
def test_every_part_enters_the_fingerprint(tmp_path: Path, name: str) -> None:
    """A change of any part that training can see changes the hash, as does one bit of one pixel."""
    dataset = make(tmp_path)
    if name == "images":
        images = np.load(dataset.images)
        images[-1, -1, -1, -1] ^= 1
        np.save(dataset.images, images)
        changed = dataset
    elif name == "names":
        changed = replace(dataset, facts=replace(dataset.facts, names=("depth", "pitch")))
    else:
        value = getattr(dataset, name)
        other: Any = value + 1 if name in ARRAYS else (*value[:-1], 9.5)
        changed = replace(dataset, **{name: other})
    assert fingerprint(changed) != dataset.facts.fingerprint


@pytest.mark.parametrize("name", ["facts.json", "images.npy", "targets.npy", "test.npy"])
def test_missing_file_names_the_folder_to_delete(tmp_path: Path, name: str) -> None:
    """A cache entry that someone has damaged is an error, never a silent guess."""
    write(make(tmp_path), tmp_path)
    (tmp_path / name).unlink()
    with refused(DataError, place=str(tmp_path), got="is damaged"):
        read(tmp_path)


def test_facts_that_are_cut_off_are_an_error(tmp_path: Path) -> None:
    """Half a JSON file is an error that says what to do."""
    write(make(tmp_path), tmp_path)
    (tmp_path / "facts.json").write_text((tmp_path / "facts.json").read_text()[:100])
    with refused(DataError, place="facts.json", expected="JSON", remedy="delete"):
        read(tmp_path)
