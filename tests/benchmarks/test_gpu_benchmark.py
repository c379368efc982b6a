"""Promise: the benchmark of a GPU runs, here on the CPU through the same code, and invents nothing without one."""

import itertools
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from benchmarks.gpu import SETTING, Limits, Work, lent, main, networks, one_process, whole_sandbox, work_of
from benchmarks.gpu_precision import PUBLISHED, compared, measured, opened_bench
from benchmarks.gpu_rows import goals, tables
from benchmarks.gpu_rows import main as rows_of
from tacevo.choices import Device, Precision
from tacevo.config.compose import compose
from tacevo.runs.answers import task_without_data
from tacevo.text import table

pytestmark = pytest.mark.room("estimate")


@pytest.fixture(autouse=True)
def _torch_settings() -> Iterator[None]:
    """Undo what a training sets for its whole process."""
    before = torch.get_deterministic_debug_mode(), torch.backends.cudnn.allow_tf32
    with torch.random.fork_rng(devices=[]):
        yield
    torch.set_deterministic_debug_mode(before[0])
    torch.backends.cudnn.allow_tf32, torch.backends.cuda.matmul.allow_tf32 = before[1], False


@pytest.mark.slow
def test_each_network_is_measured_in_each_precision() -> None:
    """A row for each of two networks and three precisions, with the limit and what sets it."""
    chosen = dict(itertools.islice(networks(), 2))
    header, _, *rows = one_process(torch.device("cpu"), chosen, size=16, side=64, steps=1, batch=4).splitlines()
    assert "images/s" in header
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert [row[0] for row in cells[:2]] == list(chosen)
    assert {row[1] for row in cells} == {precision.value for precision in Precision}
    assert len(cells) == 6
    assert all(row[5] in {"arithmetic", "memory"} for row in cells)


@pytest.mark.slow
def test_predicted_memory_stands_beside_what_is_taken() -> None:
    """A row for each network; on a CPU nothing is taken of a GPU."""
    rows = tables(lent(torch.device("cpu"), dict(itertools.islice(networks(), 2)), size=32, batch=4))[0]
    assert [row["network"] for row in rows] == ["baseline", "g05s02"]
    assert all(int(row["MiB predicted"]) > 512 and row["MiB at most"] == "0" for row in rows)


@pytest.mark.slow
def test_whole_sandbox_is_measured_with_one_candidate_and_with_two() -> None:
    """A row for each number of candidates at once."""
    small = ["experiment=published_force", "training.batch_size=8", "data.image_size=16"]
    assert len(whole_sandbox(small, at_once=(1, 2)).splitlines()) == 4


@pytest.mark.slow
def test_work_of_a_network_is_counted_by_hand() -> None:
    """One layer of 768 x 2 weights: forward, and back to its weights; the image itself asks for no gradient."""
    _, task = task_without_data("force", 16)
    source = "class ImageRegressionCNN(nn.Module):\n    def __init__(self):\n        super().__init__()\n"
    source += "        self.out = nn.Linear(768, 2)\n    def forward(self, x):\n        return self.out(x.flatten(1))\n"
    work = work_of(source, task.contract)
    assert work == Work(flops=2 * 2 * 768 * 2, traffic=5 * 2 * 4)
    assert work.bound(Limits(arithmetic=6144.0 * 7, traffic=1e9)) == (7.0, "arithmetic")


@pytest.mark.slow
def test_precisions_are_compared_with_float32(tmp_path: Path) -> None:
    """A row for tf32, which a CPU computes as float32, for bf16, and for the noise of another seed."""
    sources = [source for _, source in itertools.islice(networks(3, PUBLISHED), 1, None)]
    bench = opened_bench(torch.device("cpu"), str(tmp_path), images=140, epochs=1)
    tf32, bf16, noise = (row for rows in tables(measured(bench, sources)) for row in rows)
    assert (tf32["rank correlation"], tf32["least"], tf32["most"]) == ("1.000", "1.0000", "1.0000")
    assert {row["networks"] for row in (tf32, bf16, noise)} == {"3 of 3"}
    assert noise["trained in"] == "float32, another seed"
    assert (bf16["least"], bf16["most"]) != ("1.0000", "1.0000")


def test_comparison_is_counted_by_hand() -> None:
    """Ranks of those that trained both times, and how much larger a loss is."""
    (row,) = tables(compared([1.0, 2.0, 3.0, None, 4.0], {"x": [2.0, 2.0, 4.5, 1.0, None]}))[0]
    assert row["networks"] == "3 of 5"
    assert row["rank correlation"] == "0.866"  # of ranks 1, 2, 3 and 1.5, 1.5, 3
    assert [row[name] for name in ("loss by float32's: median", "least", "most")] == ["1.5000", "1.0000", "2.0000"]


@pytest.mark.slow
def test_start_of_a_process_is_measured_in_stages() -> None:
    """Each in a process of its own, without and with libraries; here there are none, and no step is recorded."""
    check = "import torch; from benchmarks.gpu_start import measured; print(measured(torch.device('cpu'), 1))"
    said = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True).stdout
    first, second = tables(said)[0]
    assert [*first] == ["s of a process", "fork", "driver", "product", "convolution", "in all"]
    assert second["s of a process"] == "with 0 libraries mapped"


def results(folder: Path, failed: str = "none") -> dict[str, str]:
    """Write what some parts of the script leave, and return the figures that follow, by name."""
    bench = table(
        ["network", "precision", "eager", "captured, contiguous", "captured, channels_last", "limit"],
        [
            ["baseline", "tf32", "4,000", "5,000", "6,000", "24,000"],
            ["g05s02", "tf32", "6,000", "25,000", "24,000", "99,000"],
        ],
    )
    texts = {
        "versions": f"2.13.0 13.0\nname\nNVIDIA H100\nfailed: {failed}",
        "bench": f"== bench: python\n{bench}\ntook 80 s",
        "estimate": "hours: about 1.25 for",
        "estimate-before": "hours: about 2.9 for",
        "retrain": "retrained: 5 of 5 evaluations\ntrained: 5; weights are bit for bit as recorded",
        "search": "took 61 s",
        "study": "took 36 s",
        "walls": ' "level": "kernel",\n "level": "kernel",',
        "killed": "equal bytes: 1 worker, and 3 workers after a kill",
    }
    for name, text in texts.items():
        (folder / f"{name}.txt").write_text(text)
    return {name: measured for name, _, measured in goals({path.stem: path.read_text() for path in folder.iterdir()})}


def test_results_of_the_script_become_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each figure that has a goal, from the file of its part; a part that is missing was not measured."""
    rows = results(tmp_path)
    assert rows["captured by eager, baseline, tf32"] == "1.50 (4,000 and 6,000 images/s)"
    assert rows["captured by eager, the fastest network (g05s02), tf32"].startswith("4.17 ")
    assert rows["the paper's search in tf32, each step run eagerly, two at once, h"] == "2.9"
    assert rows["the same, captured, as many at once as fit, h"] == "1.25"
    assert rows["a study of 5 networks x 20 seeds x 50 epochs, h"].startswith("3.0 ")  # 300 times 36 s
    assert rows["candidates/h of a search of 61 at 256 px (800 images, 5 epochs)"].startswith("3,600 ")
    assert rows["trainings that --retrain repeated"] == "5 of 5, bit for bit"
    assert (rows["confinement of a candidate"], rows["1 worker, and 3 after a kill"][:11]) == ("kernel", "equal bytes")
    assert rows["start of a process with libraries mapped, s"] == "not measured"
    assert rows_of([str(tmp_path)]) == 0
    assert "| g05s02   | tf32" in capsys.readouterr().out


def test_part_that_failed_gives_no_figure(tmp_path: Path) -> None:
    """Its time says nothing."""
    rows = results(tmp_path, failed="search study")
    assert rows["a study of 5 networks x 20 seeds x 50 epochs, h"] == "not measured"
    assert rows["candidates/h of a search of 61 at 256 px (800 images, 5 epochs)"] == "not measured"


def test_script_needs_a_gpu(tmp_path: Path) -> None:
    """Without one it says so, and nothing is run."""
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    ended = subprocess.run(
        ["bash", "benchmarks/on_a_gpu.sh", str(tmp_path / "out"), sys.executable],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ended.returncode, ended.stdout) == (2, "no CUDA device that torch can use\n")


def test_setting_of_a_gpu_is_one_that_a_search_takes() -> None:
    """Nothing else reads it where there is no GPU."""
    assert compose([*SETTING, "training.gpu=NVIDIA H200", "executor.per_gpu=2"]).training.device is Device.cuda


def test_without_a_gpu_nothing_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    """It says so in a line, and ends with a status of its own."""
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    assert main() == 2
    said = capsys.readouterr()
    assert said.err == "no CUDA device that torch can use; nothing was measured\n"
    assert said.out == ""
