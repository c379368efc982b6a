"""A source that a user brings: its code is a part of the cache's key, and what it raises is told as a fault of it."""

from pathlib import Path

import pytest
from refusals import refused
from smallest import ARCHIVES

from tacevo.config.compose import compose
from tacevo.data.dataset import Dataset
from tacevo.errors import DataError
from tacevo.runs.datasets import load_data
from tacevo.runs.progress import Progress

SOURCE = """
from dataclasses import dataclass
from functools import partial
import numpy as np
from tacevo.parts.source import Catalogue
from tacevo.records import Kind


@dataclass(frozen=True)
class Grey:
    image_size: int

    def describe(self):
        return {"source": "grey"}

    def catalogue(self):
        labels = np.arange(60, dtype=np.int64) % 2
        pictures = [partial(self.picture, row) for row in range(60)]
        return Catalogue(
            kind=Kind.classification, names=("a", "b"), labels=labels, image_size=self.image_size, pictures=pictures
        )

    def picture(self, row):
        return np.full((3, self.image_size, self.image_size), row, np.uint8)
"""


def _loaded(folder: Path) -> Dataset:
    settings = [f"data.source={folder}/grey.py:Grey", "data.image_size=16", "task.outputs=2", "llm=grammar"]
    config = compose(["task=grating", *settings, f"store.root={folder}/store", *ARCHIVES])
    with Progress() as view:
        return load_data(config, view)


def test_edit_of_a_source_makes_its_data_again(tmp_path: Path) -> None:
    """And the same code finds them."""
    file = tmp_path / "grey.py"
    file.write_text(SOURCE)
    first = _loaded(tmp_path)
    assert _loaded(tmp_path).images == first.images
    file.write_text(SOURCE.replace("row, np.uint8", "255 - row, np.uint8"))
    assert _loaded(tmp_path).facts.fingerprint != first.facts.fingerprint


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('return {"source": "grey"}', "raise KeyError('there')"),
        ("labels = np.arange(60, dtype=np.int64) % 2", "labels = np.load('nowhere.npy')"),
        ("return np.full((3, self.image_size, self.image_size), row, np.uint8)", "return 1 / 0"),
    ],
)
def test_what_a_source_raises_is_its_fault(tmp_path: Path, old: str, new: str) -> None:
    """With its file and line, and no traceback of ours."""
    (tmp_path / "grey.py").write_text(SOURCE.replace(old, new))
    with refused(DataError, got="grey.py, line "):
        _loaded(tmp_path)
