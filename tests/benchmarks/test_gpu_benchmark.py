"""Promise: the benchmark of a GPU runs, here on the CPU through the same code, and invents nothing without one."""

import itertools
from collections.abc import Iterator

import pytest
import torch

from benchmarks.gpu import SETTING, Limits, Work, main, networks, one_process, whole_sandbox, work_of
from tacevo.choices import Device, Precision
from tacevo.config.compose import compose
from tacevo.runs.answers import task_without_data


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
