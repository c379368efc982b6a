"""Promise: on a GPU a search gives the same bytes with any number of workers, and its trainings repeat bit for bit.

`make test-gpu` runs it. On an NVIDIA H200 the same was seen by hand, before these tests were written.
"""

import json
from pathlib import Path

import pytest
import torch
from commands import tacevo
from gpus import needs_gpu
from smallest import SMALLEST, UNTRACKED

from tacevo.choices import Confinement, Precision
from tacevo.records import Reason
from tacevo.results.run import read_run

SIZES = ["search.generations=1", "search.candidates=4", "search.initial=4", "data.image_size=32"]


def search(directory: Path, *overrides: str, status: int = 0) -> str:
    """Search on the first GPU, with stores of its own; return what it said."""
    gpu = ["training.device=cuda", f"training.gpu={torch.cuda.get_device_name(0)}", "numerics=fast"]
    places = [f"run.dir={directory}/run", f"store.root={directory}/cache", "sandbox.require=none", UNTRACKED]
    return tacevo("search", *SMALLEST, *SIZES, *gpu, *places, *overrides, status=status).stderr


@needs_gpu
@pytest.mark.parametrize("precision", Precision)
def test_workers_change_no_byte_and_trainings_repeat(tmp_path: Path, precision: Precision) -> None:
    """One after the other with all the memory, and three at once with what is predicted."""
    setting = f"training.precision={precision}"
    search(tmp_path / "one", setting, "executor.workers=1", "executor.per_gpu=3")
    search(tmp_path / "three", setting, "executor.workers=3", "executor.per_gpu=null")
    one, three = (read_run(tmp_path / each / "run") for each in ("one", "three"))
    assert three.digest == one.digest
    assert not any(line.not_deterministic for line in one.trained)
    assert any(line.captured for line in one.trained)
    tacevo("replay", tmp_path / "one" / "run", "--retrain")


@needs_gpu
def test_walls_hold_a_driver_that_works_and_change_no_byte(tmp_path: Path) -> None:
    """Trainings behind them are recorded as without, and the record says what held; the probe has those of a CPU."""
    search(tmp_path / "plain")
    search(tmp_path / "walled", "sandbox.require=kernel")
    plain, walled = (read_run(tmp_path / each / "run") for each in ("plain", "walled"))
    assert walled.digest == plain.digest
    held = json.loads((tmp_path / "walled" / "run" / "run.json").read_text())["confinement"]
    assert {measures["level"] for measures in held} == {Confinement.kernel}
    assert any("gpu" in measures for measures in held)


@needs_gpu
def test_candidate_beyond_its_memory_is_judged_so(tmp_path: Path) -> None:
    """Here the baseline, so the search ends."""
    said = search(tmp_path, "data.image_size=64", "training.gpu_memory_mib=64", status=2)
    assert Reason.out_of_memory.value in said


@needs_gpu
def test_study_and_export_go_on_from_it(tmp_path: Path) -> None:
    """The exported weights are those that the search recorded."""
    search(tmp_path)
    tacevo("study", tmp_path / "run", "elites=1", "seeds=2", "epochs=1")
    tacevo("export", tmp_path / "run", "g00s00", "like=search", "--retrained", "-o", tmp_path / "network")
    (told,) = json.loads((tmp_path / "network" / "run.json").read_text())["trainings"]
    (recorded,) = (line.weights for line in read_run(tmp_path / "run").trained if line.id == "g00s00")
    assert told["weights_sha256_after_last_epoch"] == recorded
