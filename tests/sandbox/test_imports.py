"""Promise: the zygote leaves out torch's compiler, and no candidate's answer depends on that."""

import os
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tacevo.choices import Confinement, Numerics
from tacevo.cli.inspect import task_without_data
from tacevo.records import Json, Limits, Reason, Task, to_json
from tacevo.runs.wiring import ENTRIES, recipe_of
from tacevo.sandbox.client import Died, Finished, Frame, Sandbox
from tacevo.sandbox.processes import children
from tacevo.sandbox.protocol import Message, Sort
from tacevo.training.evaluation import Examples, Setting
from tacevo.training.numerics import environment

LIMITS = Limits(seconds=60, memory_mib=1000)


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sandbox]:
    """Open a sandbox with the real entries and two attacks."""
    images = tmp_path_factory.mktemp("images") / "images.npy"
    np.save(images, np.zeros((12, 3, 32, 32), np.uint8))
    attacks = {name: f"attacks:{name}" for name in ("import_modules", "write_raw")}
    with Sandbox(
        entries={**ENTRIES, **attacks},
        environment=environment(Numerics.portable),
        arrays={"images": images},
        strongest=Confinement.process,  # an attack finds the pipe by a file
    ) as opened:
        yield opened


@pytest.fixture(scope="module")
def force() -> Task:
    """Return the task of the forces, at 32 pixels."""
    return task_without_data("force", 32)[1]


def probed(sandbox: Sandbox, source: str, task: Task) -> Finished | Died:
    """Probe a source that no policy has seen."""
    sizes = {"parameters": 10**9, "flops": 10**12, "modules": 10_000}
    header: Json = {"source": source, "contract": to_json(task.contract), "limits": sizes}
    return sandbox.run("probe", header, b"", LIMITS)


def test_probe_and_training_need_no_compiler(sandbox: Sandbox, force: Task) -> None:
    """An honest network is probed and trained below one zygote, which has not imported torch's compiler."""
    config, _ = task_without_data("force", 32)
    telling = f"{force.baseline}\nimport sys\nif 'torch._dynamo' in sys.modules:\n    raise RuntimeError('imported')\n"
    before = len(children(os.getpid()))
    judged = probed(sandbox, telling, force)
    assert isinstance(judged, Finished)
    assert "profile" in str(judged.frames[0].header)
    rows = np.arange(12)
    examples = Examples(
        train=rows[:8],
        validation=rows[8:],
        train_targets=np.zeros((8, 3), np.float32),
        validation_targets=np.zeros((4, 3), np.float32),
        mean=(0.0,) * 3,
        deviation=(1.0,) * 3,
        fingerprint="",
    )
    recipe = replace(recipe_of(config), epochs=1, batch_size=4)
    setting = Setting(contract=force.contract, fingerprint="", recipe=recipe, numerics=Numerics.portable)
    trained = setting.train(sandbox.run, telling, 0, examples=examples, predicted=[examples.validation])
    assert isinstance(trained, Finished)
    assert "weights_sha256" in str(trained.frames[-1].header)
    assert len(children(os.getpid())) == before + 1


@pytest.mark.slow
def test_process_that_imports_more_runs_where_all_of_it_is(sandbox: Sandbox) -> None:
    """It begins again, so that it finds the compiler there, and no module that is nowhere; nothing comes twice."""
    answer = sandbox.run("import_modules", ["torch._dynamo", "no_such_module"], b"", LIMITS)
    assert answer == Finished((Frame("begun", b""), Frame([["torch._dynamo"], ["torch._dynamo"]], b"")))


def test_claim_to_need_a_module_is_believed_once(sandbox: Sandbox) -> None:
    """A candidate that only says so runs once more, and then has crashed."""
    claim = Message.of(Sort.unprepared, None).to_bytes()
    answer = sandbox.run("write_raw", None, claim, LIMITS)
    assert answer == Died(Reason.crashed, "it sent a message of sort unprepared")
