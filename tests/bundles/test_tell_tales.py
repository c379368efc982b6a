"""Promise: a bundle tells nothing of who made it, and where: no user, host, home, directory or private server."""

import io
import lzma
import re
import sys
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from asked import KEY
from commands import tacevo
from llm_script import Body, Script
from llm_server import serving
from small_recordings import save_image
from smallest import ARCHIVES, UNTRACKED

pytestmark = [pytest.mark.slow, pytest.mark.room("publishing", "hosted")]

#: What stands in each name that must not be published.
TELL_TALE = "zaphod"

#: A network, and one whose error names a file of this machine's Python.
NETWORK = """\
```python
import torch.nn as nn
{}

class ImageRegressionCNN(nn.Module):
    def __init__(self, num_outputs=3):
        super().__init__()
        self.conv = nn.Conv2d(3, {}, 3, stride=4)
        self.head = nn.Linear({}, num_outputs)

    def forward(self, x):
        return self.head(self.conv(x).relu().mean((2, 3)))
```
"""

SEARCH = [
    "experiment=null",
    "task=force",
    "llm=anthropic",
    "training.epochs=1",
    "search.generations=1",
    "search.candidates=3",
]


def answer(body: Body) -> str:
    """Answer every other request with a network that cannot be imported."""
    width = 2 + len(str(body)) % 7
    return NETWORK.format("from torch.nn import Nonexistent" if width % 2 else "", width, width)


class Told(NamedTuple):
    """A bundle, what its maker was told, and what the bundle must not tell."""

    bundle: Path
    out: str
    words: tuple[str, ...]


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Told:
    """Search, study and publish as a user with tell-tale names."""
    folder = tmp_path_factory.mktemp(f"of-{TELL_TALE}")
    images = folder / "forces"
    rows = [f"{number}.png,{number / 7},{number % 5},{number % 3}\n" for number in range(40)]
    for number in range(40):
        save_image(images / f"{number}.png", 6 * number, (32, 32))
    (images / "labels.csv").write_text("".join(["image,fx,fy,fz\n", *rows]))
    data = ["data=csv", f"data.root={images}", f"data.table={images}/labels.csv", "data.image_size=32"]
    places = [f"run.dir={folder}/run", f"store.root={folder}/cache", "data.target_columns=[fx,fy,fz]"]
    names = {name: f"{TELL_TALE}-{name.lower()}" for name in ("USER", "LOGNAME", "USERNAME", "HOSTNAME")}
    with serving(Script(answer=answer)) as server, pytest.MonkeyPatch.context() as patch:
        for name, value in {**names, "HOME": str(folder / "home"), "ANTHROPIC_API_KEY": KEY}.items():
            patch.setenv(name, value)
        address = server.url.removeprefix("http://")
        tacevo("search", *SEARCH, *ARCHIVES, UNTRACKED, *data, *places, f"llm.base_url={server.url}", cwd=folder)
        study = ["study", f"run={folder}/run", "elites=1", "seeds=2", "epochs=1"]
        tacevo(*study, cwd=folder)
        tacevo(*study, f"data.root={images}", "data.split_seed=3", cwd=folder)
        tacevo("noise", f"run={folder}/run", "elites=1", "seeds=2", cwd=folder)
        out = tacevo("publish", folder / "run", "-o", folder / "run.zip", "--author", "A. Nyone", cwd=folder).stdout
    own = [sys.prefix, sys.base_prefix, *(path for path in sys.path if len(path) > 1)]
    return Told(folder / "run.zip", out, (TELL_TALE, str(tmp_path_factory.getbasetemp()), address, *own))


def unpacked(name: str, data: bytes) -> Iterator[tuple[str, bytes]]:
    """Return a member as it is, and what is packed in it: archives, texts, and the streams of a PDF."""
    yield name, data
    if name.endswith(".zip"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for inner in archive.namelist():
                yield from unpacked(f"{name}/{inner}", archive.read(inner))
    if name.endswith(".xz"):
        yield from unpacked(name.removesuffix(".xz"), lzma.decompress(data))
    if name.endswith(".pdf"):
        for stream in re.findall(rb"stream\r?\n(.*?)endstream", data, re.DOTALL):
            yield f"{name}/stream", zlib.decompressobj().decompress(stream)


def test_bundle_tells_nothing_of_its_maker(told: Told) -> None:
    """Not in any member, whatever it is packed in, nor in the headers of the file."""
    members = list(unpacked("run.zip", told.bundle.read_bytes()))
    assert [(name, word) for name, data in members for word in told.words if word.encode() in data] == []


def test_bundle_holds_what_could_have_told(told: Told) -> None:
    """The error of a candidate that could not be imported is there, and packed texts and drawings were read."""
    members = dict(unpacked("run.zip", told.bundle.read_bytes()))
    error = b"cannot import name 'Nonexistent' from 'torch.nn' (torch/nn/__init__.py)"
    rejected = [name for name, data in members.items() if name.endswith(".rejected.txt") and error in data]
    assert rejected
    assert error in members["run.zip/store.jsonl"]
    assert any(name.endswith(".pdf/stream") for name in members)


def test_maker_is_told_what_readers_get(told: Told) -> None:
    """Licence, author, and how many labels of test images the two studies keep: four of each split."""
    said = told.out.splitlines()
    assert {"licence: CC-BY-4.0", "author: A. Nyone", "the labels of 8 test images are in it"} <= {*said}
