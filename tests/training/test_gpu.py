"""Promise: what a GPU is given is checked before a candidate runs, and decides what it computes with.

There is no GPU here: the code of one runs on the CPU, with what stands for `torch.cuda` where it asks the driver.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from refusals import refused
from training_jobs import RECIPE, SOURCE, examples, header_of, payload_of, trained

from tacevo.choices import Device, Numerics, Precision
from tacevo.errors import ConfigError, SandboxError
from tacevo.records import Gpu, Reason, Recipe, to_json, written
from tacevo.training.gpu import Resident, equip, look, multiply_in
from tacevo.training.memory import CONTEXT_MIB
from tacevo.training.numerics import check_machine, environment
from tacevo.training.trainer import run
from tacevo.typed import convert

MIB = 2**20
GPU = Gpu(model="NVIDIA H200", precision=Precision.float32, memory_mib=4096)
DATA = examples()


class Cuda:
    """A driver of one GPU; it notes CUDA_VISIBLE_DEVICES when it is first asked, and the limits that it gets."""

    def __init__(self, model: str = "NVIDIA H200", free_mib: int = 16_000, total_mib: int = 16_384) -> None:
        self.fractions: list[float] = []
        self.visible: str | None = None
        self._model, self._free, self._total = model, free_mib * MIB, total_mib * MIB

    def get_device_name(self, device: int) -> str:
        """Name the GPU."""
        self.visible = os.environ.get("CUDA_VISIBLE_DEVICES")
        return self._model

    def mem_get_info(self, device: int) -> tuple[int, int]:
        """Return free and all memory."""
        return self._free, self._total

    def get_device_properties(self, device: int) -> SimpleNamespace:
        """Describe the GPU."""
        return SimpleNamespace(total_memory=self._total)

    def memory_stats(self, device: int) -> dict[str, int]:
        """Count what the allocator refused."""
        return {"num_ooms": 3}

    def set_per_process_memory_fraction(self, fraction: float, device: int) -> None:
        """Note a limit."""
        self.fractions.append(fraction)


@pytest.fixture(autouse=True)
def _torch_settings(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Undo what a training sets for its whole process, because here it does not end with it."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "of this process")
    before = torch.get_deterministic_debug_mode(), torch.backends.cudnn.allow_tf32
    with torch.random.fork_rng(devices=[]):
        yield
    torch.set_deterministic_debug_mode(before[0])
    torch.backends.cudnn.allow_tf32, torch.backends.cuda.matmul.allow_tf32 = before[1], False


def header_on(gpu: Gpu, *, per_gpu: int = 1, source: str = SOURCE) -> Any:
    """Write the header of a training on a GPU that it was lent."""
    recipe = written(replace(RECIPE, gpu=gpu))
    return {**header_of(source, DATA), "recipe": recipe, "lease": {"visible": "5", "per_gpu": per_gpu}}


def equipped(header: Any, cuda: Cuda | None = None) -> Any:
    """Make the images resident as on a GPU, in the memory of the CPU."""
    return equip(header, payload_of(DATA), {"images": DATA.images}, cuda=cuda or Cuda(), device="cpu")


def test_resident_images_train_to_the_same_bits() -> None:
    """The images on the device are those of the file, whatever rows are asked for in which order."""
    header = header_on(GPU)
    resident = equipped(header)["images"]
    assert isinstance(resident, Resident)
    rows = DATA.train[[7, 3, 3, 100]]
    assert resident[rows].dtype is torch.uint8
    assert np.array_equal(resident[rows].numpy(), DATA.images[rows])
    assert trained(header, DATA, resident) == trained(header_of(SOURCE, DATA), DATA)


def test_only_rows_that_a_training_uses_are_copied() -> None:
    """Test images stay off the device in a search, and a row that is asked for twice lies there once."""
    images = np.arange(12, dtype=np.uint8).reshape(6, 1, 1, 2)
    resident = Resident(images, np.array([4, 1, 1]), torch.device("cpu"))
    assert resident[np.array([4, 1])].tolist() == [[[[8, 9]]], [[[2, 3]]]]
    assert resident._images.shape == (2, 1, 1, 2)


def test_training_gets_the_gpu_that_it_was_lent_and_so_much_of_its_memory() -> None:
    """The driver starts with that GPU in sight only, and torch may take the recipe's memory of it."""
    cuda = Cuda()
    equipped(header_on(GPU), cuda)
    assert (cuda.visible, cuda.fractions) == ("5", [0.25])


def test_training_that_was_lent_less_has_less_and_says_what_it_was_refused() -> None:
    """Its last frame has the count of torch's allocator; with all of the recipe's memory there is no such frame."""
    header, cuda = header_on(GPU), Cuda()
    less = {**header, "lease": {"visible": "5", "mib": 2048}}
    arrays = equipped(less, cuda)
    assert cuda.fractions == [0.125]
    frames: list[Any] = []
    run(less, payload_of(DATA), arrays, lambda head, _: frames.append(head))
    assert frames[-1] == {"refused": 3}
    assert frames[:-1] == [head for head, _ in trained(header, DATA, equipped(header)["images"])]
    assert "refused" not in equipped({**header, "lease": {"visible": "5", "mib": GPU.memory_mib}})


def looked(capture: Any = None, *, walled: bool = False) -> Any:
    """Look at a GPU as before a first training, on the CPU; return what is sent."""
    recipe = written(replace(RECIPE, gpu=replace(GPU, captured=capture is not None)))
    header = {"recipe": recipe, "device": "cuda", "walled": walled, "lease": {"visible": "5", "mib": 512}}
    arrays = equip(header, b"", {}, cuda=Cuda(free_mib=9000), device="cpu")
    frames: list[Any] = []
    recording = {} if capture is None else {"capture": capture}
    look(header, b"", {**arrays, **recording}, lambda *frame: frames.append(frame), device="cpu")
    return frames


def test_look_at_a_gpu_trains_and_tells_what_is_free() -> None:
    """A step is recorded there where trainings will record theirs."""
    taken: list[str] = []

    def capture(step: Any) -> Any:
        def replay() -> None:
            taken.append("replayed")
            step()

        return replay

    assert looked() == looked(capture) == [({"free_mib": 9000}, b"")]
    assert taken == ["replayed"] * 2  # eight images, in batches of four


def test_look_at_a_gpu_says_what_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """What does not train; and behind walls, which must not decide how candidates train, no step that is recorded."""

    def capture(step: Any) -> Any:
        raise RuntimeError("CUDA error: operation not permitted")

    assert looked(capture) == [({"free_mib": 9000}, b"")]
    ((failed, _),) = looked(capture, walled=True)
    assert "training.captured=false" in failed["failed"]
    monkeypatch.setattr("tacevo.training.gpu._SMALL", "class Small(nn.Module): pass")
    ((failed, _),) = looked()
    assert Reason.construction_failed.value in failed["failed"]


def test_job_of_a_cpu_is_left_as_it_is() -> None:
    """A probe, and every training on a CPU, gets the arrays of the file, and no driver is asked."""
    arrays = {"images": DATA.images}
    assert equip(header_of(SOURCE, DATA), b"", arrays, cuda=None) is arrays
    assert os.environ["CUDA_VISIBLE_DEVICES"] == "of this process"


@pytest.mark.parametrize(
    ("cuda", "per_gpu", "expected", "got", "remedy"),
    [
        (Cuda(model="NVIDIA A100"), 1, "NVIDIA H200", "NVIDIA A100", "set training.gpu"),
        (Cuda(free_mib=4095), 1, "4096 MiB free on the GPU", "4095 MiB", "end what else uses it"),
        (Cuda(total_mib=4 * (4096 + CONTEXT_MIB) - 1), 4, "for 4 candidates", "20479 MiB", "lower training.gpu_memory"),
    ],
)
def test_gpu_that_is_not_the_recipes_stops_the_search(
    cuda: Cuda, per_gpu: int, expected: str, got: str, remedy: str
) -> None:
    """Another model, a full device, or more candidates than fit: no candidate is to blame, so nothing is recorded."""
    with refused(SandboxError, expected=expected, got=got, remedy=remedy):
        equipped(header_on(GPU, per_gpu=per_gpu), cuda)


def test_lease_without_a_gpu_in_the_recipe_is_refused() -> None:
    """A key that names no GPU never stands for a training on one."""
    with refused(SandboxError, got="a recipe for a CPU"):
        equipped({**header_on(GPU), "recipe": to_json(RECIPE)})


@pytest.mark.parametrize("precision", Precision)
def test_tf32_is_used_where_it_is_asked_for_only(precision: Precision) -> None:
    """Convolutions too, where torch itself would use it unasked."""
    multiply_in(precision)
    used = (torch.backends.cuda.matmul.allow_tf32, torch.backends.cudnn.allow_tf32)
    assert used == (precision is Precision.tf32,) * 2


def test_bf16_computes_otherwise_and_answers_in_float32() -> None:
    """Its predictions are others, finite, and of the same size; layers see half the bits, the loss does not."""
    telling = SOURCE.replace(
        "return self.head(self.body(x))", "self.seen = self.body(x).dtype\n        return self.head(self.body(x))"
    )
    header = header_on(replace(GPU, precision=Precision.bf16), source=telling)
    cast, plain = trained(header, DATA), trained(header_on(GPU), DATA)
    assert cast[0][1] != plain[0][1]
    values = np.frombuffer(cast[-2][1], np.float32)
    assert values.shape == np.frombuffer(plain[-2][1], np.float32).shape
    assert np.isfinite(values).all()
    asserting = telling.replace("return self", "assert self.seen is torch.bfloat16\n        return self")
    assert "weights_sha256" in trained({**header, "source": asserting}, DATA)[-1][0]


def test_bf16_is_no_excuse_for_another_type() -> None:
    """A candidate that answers in bfloat16 by itself is told so where nothing was cast."""
    own = SOURCE.replace("return self.head(self.body(x))", "return self.head(self.body(x)).to(torch.bfloat16)")
    ((end, _),) = trained(header_on(GPU, source=own), DATA)
    assert end["rejection"]["reason"] == Reason.bad_output


def test_device_that_is_full_is_a_verdict() -> None:
    """What torch raises at the limit ends this candidate only."""
    full = SOURCE.replace(
        "return self.head", "raise torch.OutOfMemoryError('CUDA out of memory. Tried to')\n        return"
    )
    ((end, _),) = trained(header_on(GPU, source=full), DATA)
    assert end["rejection"]["reason"] == Reason.out_of_memory


def test_recipe_is_read_back_as_it_was_written() -> None:
    """By the trainer, which has no pydantic, and by whoever reads a study; a recipe of a CPU says nothing of GPUs."""
    recipe = replace(RECIPE, gpu=replace(GPU, precision=Precision.tf32))
    assert Recipe.from_json(written(recipe)) == Recipe.from_json(to_json(recipe)) == recipe
    assert convert(Recipe, written(recipe), place="", error=ConfigError) == recipe
    assert "gpu" not in written(RECIPE)
    assert Recipe.from_json(written(RECIPE)) == RECIPE


@pytest.mark.slow
def test_zygote_never_asks_for_a_gpu() -> None:
    """A process that asked the driver once cannot be forked into one that uses it, whatever it imports for its jobs."""
    check = """
import torch

def asked(*_, **__):
    raise SystemExit("the driver was asked")

torch.accelerator.current_accelerator = torch.cuda.is_available = asked
torch.cuda.device_count = torch.cuda._lazy_init = asked
import tacevo.gate.probe, tacevo.training.gpu, tacevo.training.trainer
from tacevo.sandbox.candidate import Adam
parameter = torch.nn.Parameter(torch.ones(1))
parameter.grad = torch.ones(1)
Adam([parameter], 0.5).step()
raise SystemExit(float(parameter.detach()) > 0.6)
"""
    ended = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.slow
def test_what_computes_on_a_cpu_asks_no_driver() -> None:
    """An export lets torch look for a GPU often, which starts the driver where torch is built for one."""
    check = """
import torch

def asked(*_, **__):
    raise SystemExit(7)

torch.cuda._is_compiled = lambda: True
torch._C._cuda_getDeviceCount = torch.cuda._raw_device_count_nvml = asked
raise SystemExit(torch.cuda.is_available())
"""
    own = {name: value for name, value in os.environ.items() if "CUDA" not in name}
    for variables, status in ((environment(Numerics.portable), 0), (environment(Numerics.fast, Device.cuda), 7)):
        ended = subprocess.run([sys.executable, "-c", check], check=False, env={**own, **variables})
        assert ended.returncode == status


@pytest.mark.skipif(Path("/dev/nvidiactl").exists(), reason="this machine has a GPU")
def test_gpu_is_refused_where_there_is_none() -> None:
    """Before anything is downloaded, imported or trained."""
    got = "cuda, but /dev/nvidiactl does not exist"
    with refused(ConfigError, place="training.device", got=got, remedy="set training.device=cpu"):
        check_machine(Numerics.fast, Device.cuda)
