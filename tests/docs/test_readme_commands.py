"""Promise: the commands of README run, in its order, where nothing but its recordings and published runs are."""

import os
import re
import shlex
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from checkout import GOLDEN, PUBLISHED, ROOT
from commands import tacevo
from PIL import Image

SWEEP = PUBLISHED / "ablation-grating.zip"

#: Commands that search for long, or ask a model that is paid: until their first line, or until they want a key or a
#: cluster.
LONG = re.compile(r"search -m|llm=anthropic")


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_commands_of_readme_run(tmp_path: Path) -> None:
    """The demo is recorded, and the sweep is a published one; the study of a sweep has tests of its own."""
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "published").symlink_to(PUBLISHED)
    write_recordings(tmp_path / "IMAGES")
    with zipfile.ZipFile(GOLDEN / "demo.zip") as bundle:
        tacevo("cache", "import", bundle.extract("store.jsonl.xz", tmp_path), cwd=tmp_path)
    makefile, readme = ((ROOT / name).read_text(encoding="utf-8") for name in ("Makefile", "README.md"))
    demo = re.findall(r"^\t\$\(BIN\)/(tacevo .*runs/demo.*)", makefile, flags=re.MULTILINE)
    typed = re.findall(r"^    (tacevo [^#\n]+)", readme, flags=re.MULTILINE)
    assert len(demo) == 2
    assert len(typed) > 12
    for line in (*demo, *typed):
        _, *words = shlex.split(line.replace("ablations sweeps/mine", f"ablations {SWEEP} -o ablations"))
        if LONG.search(line):
            told = started(words, tmp_path)
            assert "error: " not in told or "ANTHROPIC_API_KEY" in told or "HEAD:6379" in told, told
        elif "sweep=" not in line:
            tacevo(*words, cwd=tmp_path)
    assert (tmp_path / "network" / "model.onnx").exists()


def write_recordings(folder: Path) -> None:
    """Write 40 images and the table of README's command that reads such."""
    folder.mkdir()
    images = np.random.default_rng(0).integers(0, 256, (40, 64, 64, 3), dtype=np.uint8)
    for number, image in enumerate(images):
        Image.fromarray(image).save(folder / f"{number}.png")
    rows = [f"{number}.png,{number},{number % 7},{number % 5}" for number in range(len(images))]
    (folder / "labels.csv").write_text("\n".join(["image,fx,fy,fz", *rows]))


def started(words: list[str], folder: Path) -> str:
    """Return the output of a command that has neither key nor cluster, and is stopped after its first line."""
    with subprocess.Popen(
        [sys.executable, "-m", "tacevo.cli.app", *words],
        cwd=folder,
        env={name: value for name, value in os.environ.items() if "API_KEY" not in name} | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        told = process.stdout.readline()
        process.send_signal(signal.SIGINT)
        told += process.stdout.read()
    assert "Traceback" not in told
    assert told
    return told
