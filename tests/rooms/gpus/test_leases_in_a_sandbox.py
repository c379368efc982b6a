"""Promise: a training on a GPU that was lent by memory, behind walls or not, ends as one that had all of its recipe's.

The GPU is the CPU here, and the driver's answers are made up (`fake_gpu`); sandbox, leases, walls and trainer are real.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_gpu import MODEL, NEEDED_MIB
from training_jobs import CONTRACT, RECIPE, SOURCE, examples, labelled

from tacevo.choices import Confinement, Device, Numerics, Precision
from tacevo.records import Gpu, Json, Limits, Rejection, Training
from tacevo.sandbox.client import Died, Finished, RunJob, Sandbox, Score
from tacevo.sandbox.confinement import available, in_force
from tacevo.training.evaluation import ENTRIES, LOOK, Setting
from tacevo.training.leases import Leases
from tacevo.training.numerics import environment

pytestmark = pytest.mark.timeout(120)

DATA = examples()
GPU = Gpu(model=MODEL, precision=Precision.float32, memory_mib=8192)


def trained(run: RunJob, device: Device, gpu: Gpu | None) -> Training | Rejection:
    """Train the tiny task, and judge the answer."""
    setting = Setting(
        contract=CONTRACT,
        fingerprint="abc",
        recipe=replace(RECIPE, gpu=gpu),
        numerics=Numerics.portable,
        device=device,
    )
    data = labelled(DATA)
    verdict = setting.judge(
        setting.train(run, SOURCE, 0, examples=data, predicted=[data.validation]), data, len(data.validation)
    )
    return verdict if isinstance(verdict, Rejection) else verdict[0]


class Noting:
    """Runs jobs, and notes what was lent to each training."""

    def __init__(self, run: RunJob) -> None:
        self._run = run
        self.lent: list[int | None] = []

    def run(
        self, entry: str, header: Json, payload: bytes, limits: Limits, score: Score | None = None
    ) -> Finished | Died:
        """Run one job."""
        assert isinstance(header, dict)
        lease: Any = header["lease"]
        if entry != LOOK:
            self.lent.append(lease.get("mib"))
        return self._run(entry, header, payload, limits, score)


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the images of the tiny task, beside what stands for a device file."""
    folder = tmp_path_factory.mktemp("images")
    np.save(folder / "images.npy", DATA.images)
    (folder / "nvidiactl").touch()
    return folder


@pytest.fixture(scope="module")
def plain(images: Path) -> Training:
    """Train on a CPU, as usual."""
    arrays = {"images": images / "images.npy"}
    with Sandbox(entries=ENTRIES, environment=environment(Numerics.portable), arrays=arrays) as sandbox:
        result = trained(sandbox.run, Device.cpu, None)
    assert isinstance(result, Training)
    return result


@pytest.mark.parametrize(
    ("strongest", "per_gpu", "guess", "lent"),
    [
        (Confinement.none, None, NEEDED_MIB, [NEEDED_MIB]),
        (Confinement.kernel, None, NEEDED_MIB - 1, [NEEDED_MIB - 1, GPU.memory_mib]),
        (Confinement.none, None, None, [GPU.memory_mib]),
        (Confinement.kernel, 1, None, [None]),
    ],
    ids=["enough", "too small", "unknown", "by number"],
)
def test_result_is_that_of_all_the_memory(
    images: Path, plain: Training, *, strongest: Confinement, per_gpu: int | None, guess: int | None, lent: list[Any]
) -> None:
    """Whatever is predicted, the record is the same; behind walls with doors it is, too, and they are told."""
    if strongest is Confinement.kernel and available() is not Confinement.kernel:
        pytest.skip("the kernel has no Landlock or no seccomp")
    told: list[tuple[str, ...]] = []
    entries = {"train": "fake_gpu:train", LOOK: "fake_gpu:look"}
    doors = dict.fromkeys(entries, [str(images / "nvidia*")] if strongest is Confinement.kernel else [])
    with Sandbox(
        entries=entries,
        environment=environment(Numerics.portable),
        arrays={"images": images / "images.npy"},
        equip="fake_gpu:equip",
        strongest=strongest,
        doors=doors,
        notice=told.append,
    ) as sandbox:
        noting = Noting(sandbox.run)
        leases = Leases(noting.run, ["0"], per_gpu, lambda _: guess)
        first, second = (trained(leases.run, Device.cuda, GPU) for _ in range(2))
    assert first == second == plain
    assert noting.lent == 2 * lent
    assert {in_force(measures)["level"] for measures in told} == {strongest}
    assert len(told) == 1 + len(noting.lent)
