"""Promise: hostile programs get at least the outcome that is expected of them, and none gets out or is remembered.

Each program of the shared set runs three times: through the gate as a search would run it, and past the static
policy into the probe and into the training. After each one no trap is sprung, no process is left, nothing of the
search is changed, and a decent candidate gets the very bits that it gets alone.
"""

import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from canaries import SECRET, Canaries, canaries
from gate_cases import VALID, needs_shared
from gate_cases import examples as shared
from hostile_runs import Harness, examples, open_sandbox
from waiting import eventually

from tacevo.records import Reason, Rejection, Stage, Training
from tacevo.sandbox.processes import descendants

PROGRAMS = shared("hostile")
EVERY_PROGRAM = pytest.mark.parametrize("program", PROGRAMS, ids=[program["id"] for program in PROGRAMS])

pytestmark = [pytest.mark.long, pytest.mark.timeout(120), needs_shared]


@pytest.fixture(scope="module")
def traps() -> Iterator[Canaries]:
    """Set the traps before the sandbox starts, so that it could inherit the secret."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TACEVO_CANARY", SECRET)
        with canaries() as opened:
            yield opened


@pytest.fixture(scope="module")
def harness(traps: Canaries, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Harness]:
    """Return one sandbox to all programs, so that each also finds what the others left behind."""
    folder = tmp_path_factory.mktemp("hostile")
    images, data = examples()
    np.save(folder / "images.npy", images)
    with open_sandbox(folder / "images.npy") as sandbox:
        opened = Harness(sandbox, data, folder)
        opened.probed(f"import torch._dynamo\n{VALID}")  # starts the second zygote, which is not a leftover
        yield opened


@pytest.fixture(scope="module")
def alone(harness: Harness) -> Training:
    """Train the decent candidate before anybody else."""
    outcome = harness.good_one()
    assert isinstance(outcome, Training)
    return outcome


@pytest.fixture
def contained(
    harness: Harness, traps: Canaries, alone: Training, capfd: pytest.CaptureFixture[str]
) -> Iterator[list[object]]:
    """Take a program's outcome, and see that it left no trace anywhere."""
    before = set(descendants(os.getpid()))
    outcomes: list[object] = []
    yield outcomes
    said = capfd.readouterr()
    assert traps.sprung() == []
    assert SECRET not in f"{outcomes} {said.out} {said.err}"
    assert "h010 found" not in said.out + said.err
    assert eventually(lambda: before.issuperset(descendants(os.getpid())))
    assert harness.good_one() == alone


@EVERY_PROGRAM
def test_program_gets_its_outcome_at_the_gate(program: Any, harness: Harness, contained: list[object]) -> None:
    """What must be refused is refused by the stage that must, and what trains repeats itself."""
    outcome = harness.through_the_gate(program["source"])
    contained.append(outcome)
    match program["expected"]:
        case "reject_static":
            assert isinstance(outcome, Rejection)
            assert outcome.stage in (Stage.extract, Stage.policy)
        case "reject_probe":
            assert isinstance(outcome, Rejection)
            assert outcome.stage is not Stage.train
        case "allowed_harmless":
            # One loops over its batch and mixes neighbouring images, so five images are other work than one.
            assert isinstance(outcome, Training) or outcome.reason is Reason.depends_on_batch
    if isinstance(outcome, Training):
        assert outcome.validation_losses[-1] > 0
        assert harness.through_the_gate(program["source"]) == outcome


@EVERY_PROGRAM
def test_program_is_contained_in_the_probe(program: Any, harness: Harness, contained: list[object]) -> None:
    """Past the policy, the probe still refuses what it is there for, and holds the rest."""
    outcome = harness.probed(program["source"])
    contained.append(outcome)
    assert program["expected"] != "reject_probe" or isinstance(outcome, Rejection)


@EVERY_PROGRAM
def test_program_is_contained_in_the_training(program: Any, harness: Harness, contained: list[object]) -> None:
    """Past policy and probe, no program forges a fitness or gets out."""
    outcome = harness.trained(program["source"])
    contained.append(outcome)
    assert isinstance(outcome, Rejection) or outcome.validation_losses[-1] > 0
