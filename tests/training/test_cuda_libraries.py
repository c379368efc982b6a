"""Promise: a zygote maps what CUDA opens late, and nothing where torch is built for a CPU. No GPU is asked."""

import subprocess
import sys
from pathlib import Path

import pytest

from tacevo.training.cuda_libraries import map_libraries, to_map


def maps(folder: Path, *mapped: str) -> Path:
    """Write what /proc/self/maps says of a process with such files in memory, and with memory of its own."""
    lines = ["7f00-7f01 rw-p 00000000 00:00 0 ", "7f01-7f02 rw-p 00000000 00:00 0                          [heap]"]
    lines += [f"7f{number:02}-7f99 r-xp 00001000 08:01 {number}   {path}" for number, path in enumerate(mapped)]
    (folder / "maps").write_text("\n".join(lines) + "\n")
    return folder / "maps"


@pytest.fixture
def cudnn(tmp_path: Path) -> Path:
    """Make a directory of cuDNN, whose name has a space."""
    folder = tmp_path / "with a space" / "cudnn"
    folder.mkdir(parents=True)
    for name in ("libcudnn.so.9", "libcudnn_cnn.so.9", "libcudnn_ops.so.9", "notes.txt"):
        (folder / name).touch()
    return folder


def test_parts_that_are_opened_late_are_found(tmp_path: Path, cudnn: Path) -> None:
    """The driver's library by its name, and the parts of cuDNN beside the one that torch is linked with."""
    seen = maps(tmp_path, "/x/libcudart.so.13", f"{cudnn}/libcudnn.so.9").read_text()
    assert to_map(seen) == ["libcuda.so.1", f"{cudnn}/libcudnn_cnn.so.9", f"{cudnn}/libcudnn_ops.so.9"]


def test_torch_of_a_cpu_maps_nothing(tmp_path: Path, cudnn: Path) -> None:
    """Also where cuDNN lies about."""
    assert map_libraries(maps(tmp_path, "/x/libtorch_cpu.so", f"{cudnn}/libcudnn.so.9"), exit) == []


def test_library_that_cannot_be_mapped_stops_nothing(tmp_path: Path, cudnn: Path) -> None:
    """One that needs another comes after it; one that fails is left to its first use."""
    tried: list[str] = []

    def load(name: str) -> None:
        tried.append(Path(name).name)
        if name == "libcuda.so.1" or tried == ["libcuda.so.1", "libcudnn_cnn.so.9"]:
            raise OSError("cannot open shared object file")

    done = map_libraries(maps(tmp_path, "/x/libcudart.so.13", f"{cudnn}/libcudnn.so.9"), load)
    assert [Path(name).name for name in done] == ["libcudnn_ops.so.9", "libcudnn_cnn.so.9"]


@pytest.mark.slow
def test_this_zygote_stays_as_it_is() -> None:
    """The process that forks has one thread when it has imported all, with CUDA's libraries or without."""
    check = "import os, tacevo.training.gpu; raise SystemExit(len(os.listdir('/proc/self/task')) - 1)"
    ended = subprocess.run([sys.executable, "-c", check], env={"OMP_NUM_THREADS": "1", "PATH": ""}, check=False)
    assert ended.returncode == 0
