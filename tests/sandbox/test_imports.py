"""Promise: the zygote leaves out torch's compiler, and no candidate's answer depends on that."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from checkout import LIBRARY
from hostile_runs import Harness, examples

from tacevo.choices import Confinement, Numerics
from tacevo.profile import Admitted
from tacevo.records import Limits, Reason, Training
from tacevo.sandbox.client import Died, Finished, Frame, Sandbox
from tacevo.sandbox.processes import children
from tacevo.sandbox.protocol import Message, Sort
from tacevo.training.numerics import environment

LIMITS = Limits(seconds=60, memory_mib=1000)


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sandbox]:
    """Open a sandbox with the real entries, without guards, so that a text can look around; and two attacks."""
    images = tmp_path_factory.mktemp("images") / "images.npy"
    np.save(images, examples()[0])
    attacks = {name: f"attacks:{name}" for name in ("import_modules", "write_raw")}
    with Sandbox(
        entries={"probe": "unguarded:probe", "train": "unguarded:train", **attacks},
        environment=environment(Numerics.portable),
        arrays={"images": images},
        strongest=Confinement.process,  # an attack finds the pipe by a file
    ) as opened:
        yield opened


@pytest.mark.slow
def test_probe_and_training_need_no_compiler(sandbox: Sandbox, tmp_path: Path) -> None:
    """An honest network is probed and trained below one zygote, which has not imported torch's compiler."""
    baseline = (LIBRARY / "force" / "baseline.py").read_text(encoding="utf-8")
    telling = f"{baseline}\nimport sys\nif 'torch._dynamo' in sys.modules:\n    raise RuntimeError('imported')\n"
    before = len(children(os.getpid()))
    harness = Harness(sandbox, examples()[1], tmp_path, LIMITS)
    assert isinstance(harness.probed(telling), Admitted)
    assert isinstance(harness.trained(telling), Training)
    assert len(children(os.getpid())) == before + 1


@pytest.mark.slow
def test_process_that_imports_more_runs_where_all_of_it_is(sandbox: Sandbox) -> None:
    """It begins again, so that it finds the compiler there, and no module that is nowhere; nothing comes twice."""
    answer = sandbox.run("import_modules", ["torch._dynamo", "no_such_module"], b"", LIMITS)
    assert answer == Finished((Frame("begun", b""), Frame([["torch._dynamo"], ["torch._dynamo"]], b"")))


@pytest.mark.slow
def test_claim_to_need_a_module_is_believed_once(sandbox: Sandbox) -> None:
    """A candidate that only says so runs once more, and then has crashed."""
    claim = Message.of(Sort.unprepared, None).to_bytes()
    answer = sandbox.run("write_raw", None, claim, LIMITS)
    assert answer == Died(Reason.crashed, "it sent a message of sort unprepared")
