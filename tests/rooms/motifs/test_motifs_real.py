"""Models write the same motif in many ways; what an instruction asked for is found in the answers to it.

The answers are beside the checkout, not part of it. They run in the sandbox, as candidates do.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from checkout import LIBRARY
from gate_cases import completion, contract, examples, needs_shared

from analysis.motifs.motifs import motifs_of
from analysis.motifs.structure import Anatomy, read_anatomy
from tacevo.choices import Numerics
from tacevo.gate.admission import Gate, GateLimits
from tacevo.profile import Admitted
from tacevo.records import Completion, Limits, Mode
from tacevo.rules import CURRENT
from tacevo.sandbox.client import Sandbox
from tacevo.storage.store import Store

#: Answers whose instruction names a motif; the others ask for a goal, a new form of the code, or what no motif is.
ASKED = {
    "force_000": "wider convolutions",
    "force_004": "GELU",
    "force_012": "LayerNorm in the head",
    "force_016": "residual connection",
    "force_040": "GELU",
    "force_052": "residual connection",
    "grating_000": "BatchNorm in the blocks",
    "grating_004": "LeakyReLU",
    "grating_012": "wider convolutions",
    "grating_018": "LayerNorm in the head",
    "grating_022": "spatial attention",
    "grating_024": "no dropout",
    "grating_026": "1x1 convolution",
    "grating_030": "residual connection",
    "grating_042": "GELU",
    "grating_048": "BatchNorm in the blocks",
    "grating_054": "spatial attention",
}

#: Two new forms of the baseline's code.
REFACTORED = ("grating_006", "grating_044")


@pytest.fixture(scope="module")
def sandbox() -> Iterator[Sandbox]:
    """One real sandbox for all tests of this module."""
    with Sandbox(entries={"probe": "tacevo.gate.probe:run"}, environment={"OMP_NUM_THREADS": "1"}, arrays={}) as opened:
        yield opened


def probed(sandbox: Sandbox, folder: Path, task: str, answer: Completion) -> Anatomy:
    """Put an answer through the gate and read what was admitted."""
    gate = Gate(
        run=sandbox.run,
        store=Store(folder, "probes", Mode.record),
        answers=Store(folder, "answers", Mode.record),
        contract=contract(task, 64),
        limits=GateLimits(parameters=20_000_000, flops=10**11, modules=1_000),
        probe_limits=Limits(seconds=60.0, memory_mib=2_000),
        numerics=Numerics.portable,
        rules=CURRENT,
    )
    verdict = gate.admit(answer)
    assert isinstance(verdict, Admitted), verdict
    return read_anatomy(verdict.profile)


def motifs_in(sandbox: Sandbox, folder: Path, example: Any) -> frozenset[str]:
    """Name the motifs of a real answer."""
    task = example["task"]
    baseline = (LIBRARY / task / "baseline.py").read_text(encoding="utf-8")
    answer = completion(example["response"], example["stop_reason"])
    return motifs_of(
        probed(sandbox, folder, task, answer), probed(sandbox, folder, task, completion(f"```python\n{baseline}```"))
    )


@pytest.mark.few(2)
@needs_shared
@pytest.mark.parametrize("example", [e for e in examples("llm_answers") if e["file"] in ASKED], ids=lambda e: e["file"])
def test_motif_that_was_asked_for_is_found(sandbox: Sandbox, tmp_path: Path, example: Any) -> None:
    """However the model wrote it, and whatever its parent had besides."""
    assert ASKED[example["file"]] in motifs_in(sandbox, tmp_path, example)


@pytest.mark.few(1)
@needs_shared
@pytest.mark.parametrize(
    "example", [e for e in examples("llm_answers") if e["file"] in REFACTORED], ids=lambda e: e["file"]
)
def test_new_form_of_the_code_is_no_motif(sandbox: Sandbox, tmp_path: Path, example: Any) -> None:
    """Only what runs counts."""
    assert motifs_in(sandbox, tmp_path, example) == {"2 to 4 convolutional blocks"}
