"""The gate joins extraction, policy and probe: each answer gets the verdict it deserves, and is probed once.

Some tests pass a fake sandbox in; those on real answers and attacks go through the real one.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from gate_cases import VALID, candidate, completion, contract, examples, needs_shared

from tacevo.errors import CacheMissError, SandboxError
from tacevo.gate.admission import Admitted, Gate, GateLimits
from tacevo.records import (
    Contract,
    Graph,
    Json,
    Limits,
    Mode,
    Node,
    Profile,
    Reason,
    Rejection,
    Stage,
    to_json,
)
from tacevo.sandbox.client import Died, Finished, Frame, Sandbox
from tacevo.store import Store

LIMITS = GateLimits(parameters=20_000_000, flops=10**11, modules=1_000)
PROBE_LIMITS = Limits(seconds=60.0, memory_mib=2_000)
PROFILE = Profile(
    parameters=127,
    flops=9,
    modules=3,
    graph=Graph(
        nodes=(Node(op="conv2d", weighted=True, width=4), Node(op="linear", weighted=True, width=3)),
        edges=((0, 1),),
        channels=(4,),
        kernels=(3.0,),
        hidden=(),
    ),
)
ANSWER = {"profile": to_json(PROFILE)}

Run = Callable[[str, Json, bytes, Limits], Finished | Died]


class FakeSandbox:
    """Gives every job the same outcome and keeps what it was asked."""

    def __init__(self, outcome: Finished | Died | Exception) -> None:
        self.outcome = outcome
        self.headers: list[Json] = []

    def run(self, entry: str, header: Json, payload: bytes, limits: Limits) -> Finished | Died:
        """Answer as told."""
        assert (entry, payload, limits) == ("probe", b"", PROBE_LIMITS)
        self.headers.append(header)
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return self.outcome


def sent(*headers: Json) -> Finished:
    """Make the outcome of a child that sent these frames."""
    return Finished(tuple(Frame(header, b"") for header in headers))


def gate(
    run: Run,
    root: Path,
    *,
    task: Contract | None = None,
    mode: Mode = Mode.record,
    limits: GateLimits = LIMITS,
    probe_limits: Limits = PROBE_LIMITS,
    numerics: str = "portable",
) -> Gate:
    """Make a gate, by default that of the force task."""
    store = Store(root, "probes", mode)
    task = task or contract()
    return Gate(run=run, store=store, contract=task, limits=limits, probe_limits=probe_limits, numerics=numerics)


@pytest.fixture(scope="module")
def sandbox() -> Iterator[Sandbox]:
    """One real sandbox for all tests of this module."""
    environment = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    with Sandbox(entries={"probe": "tacevo.gate.probe:run"}, environment=environment, arrays={}) as opened:
        yield opened


def test_each_stage_rejects_in_its_turn(tmp_path: Path) -> None:
    """An answer that fails early never reaches the sandbox."""
    fake = FakeSandbox(sent(ANSWER))
    found = [gate(fake.run, tmp_path).admit(completion(text)) for text in ("", "import os\n" + VALID)]
    assert [(it.stage, it.reason) for it in found if isinstance(it, Rejection)] == [
        (Stage.extract, Reason.empty),
        (Stage.policy, Reason.forbidden_import),
    ]
    assert fake.headers == []


def test_checked_text_is_the_text_that_runs(tmp_path: Path) -> None:
    """The sandbox and the caller get the very text that the policy saw."""
    fake = FakeSandbox(sent(ANSWER))
    found = gate(fake.run, tmp_path).admit(completion(f"Here:\n```python\n{VALID}```"))
    assert found == Admitted(source=VALID, profile=PROFILE)
    assert [header["source"] for header in fake.headers] == [VALID]
    assert fake.headers[0]["limits"] == {"parameters": 20_000_000, "flops": 10**11, "modules": 1_000}
    assert fake.headers[0]["contract"] == to_json(contract())


def test_equal_sources_are_probed_once(tmp_path: Path) -> None:
    """The second gate answers from the store, for an admitted source and for a rejected one."""
    rejected = sent({"rejection": to_json(Rejection(stage=Stage.probe, reason=Reason.no_gradient, detail="none"))})
    for outcome, source in ((sent(ANSWER), VALID), (rejected, candidate("return x"))):
        fake = FakeSandbox(outcome)
        assert gate(fake.run, tmp_path).inspect(source) == gate(fake.run, tmp_path).inspect(source)
        assert len(fake.headers) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"task": contract(image_size=64)},
        {"limits": replace(LIMITS, parameters=7)},
        {"limits": replace(LIMITS, flops=7)},
        {"limits": replace(LIMITS, modules=7)},
        {"numerics": "fast"},
    ],
)
def test_everything_that_can_change_a_verdict_enters_its_key(tmp_path: Path, change: dict[str, Json]) -> None:
    """A probe under one setting does not answer for another."""
    fake = FakeSandbox(sent(ANSWER))
    gate(fake.run, tmp_path).inspect(VALID)
    gate(fake.run, tmp_path, **change).inspect(VALID)
    assert len(fake.headers) == 2


def test_limits_of_the_process_enter_the_key(tmp_path: Path) -> None:
    """A candidate that ran out of time is tried again when it is given more."""
    gate(FakeSandbox(Died(Reason.out_of_time, "over 60 s")).run, tmp_path).inspect(VALID)
    longer = replace(PROBE_LIMITS, seconds=90.0)
    found = gate(lambda *_: sent(ANSWER), tmp_path, probe_limits=longer).inspect(VALID)
    assert isinstance(found, Admitted)


def test_size_of_the_answer_does_not_enter_the_key(tmp_path: Path) -> None:
    """The limit on raw text says nothing about the probe of a source that passed it."""
    fake = FakeSandbox(sent(ANSWER))
    gate(fake.run, tmp_path).inspect(VALID)
    gate(fake.run, tmp_path, limits=replace(LIMITS, source_bytes=5_000)).inspect(VALID)
    assert len(fake.headers) == 1


def test_dead_child_is_a_rejection(tmp_path: Path) -> None:
    """How the candidate died is the reason, stored like any other."""
    fake = FakeSandbox(Died(Reason.out_of_memory, "over 2000 MiB"))
    expected = Rejection(stage=Stage.probe, reason=Reason.out_of_memory, detail="over 2000 MiB")
    assert gate(fake.run, tmp_path).inspect(VALID) == expected
    assert gate(fake.run, tmp_path, mode=Mode.replay).inspect(VALID) == expected


def test_broken_sandbox_is_no_verdict(tmp_path: Path) -> None:
    """The error passes through, nothing is stored, and a repaired sandbox is asked again."""
    with pytest.raises(SandboxError, match="zygote died"):
        gate(FakeSandbox(SandboxError("zygote died")).run, tmp_path).inspect(VALID)
    assert isinstance(gate(FakeSandbox(sent(ANSWER)).run, tmp_path).inspect(VALID), Admitted)


def test_replay_never_probes(tmp_path: Path) -> None:
    """A source without a recorded probe is an error in replay."""
    fake = FakeSandbox(sent(ANSWER))
    with pytest.raises(CacheMissError, match="no recorded answer for probes request"):
        gate(fake.run, tmp_path, mode=Mode.replay).inspect(VALID)
    assert fake.headers == []


def _with_profile(**changes: Json) -> Json:
    return {"profile": {**ANSWER["profile"], **changes}}


@pytest.mark.parametrize(
    "headers",
    [
        pytest.param([], id="no frame"),
        pytest.param([ANSWER, ANSWER], id="two frames"),
        pytest.param([None], id="null"),
        pytest.param([{"profile": 3}], id="number"),
        pytest.param([{"rejection": {"stage": "probe", "reason": "bored", "detail": ""}}], id="unknown reason"),
        pytest.param([{"rejection": {"stage": "train", "reason": "crashed", "detail": ""}}], id="other stage"),
        pytest.param([_with_profile(parameters="many")], id="text for a number"),
        pytest.param([_with_profile(flops=-1)], id="negative"),
        pytest.param([_with_profile(graph={**ANSWER["profile"]["graph"], "edges": [[1, 0]]})], id="edge backwards"),
        pytest.param([_with_profile(graph={**ANSWER["profile"]["graph"], "edges": [[0, 9]]})], id="edge to nowhere"),
    ],
)
def test_forged_answer_is_a_crash(tmp_path: Path, headers: list[Json]) -> None:
    """A candidate can write frames of its own; what is no probe's answer counts against it."""
    found = gate(FakeSandbox(sent(*headers)).run, tmp_path).inspect(VALID)
    assert isinstance(found, Rejection)
    assert (found.stage, found.reason) == (Stage.probe, Reason.crashed)


@pytest.mark.timeout(60)
def test_candidate_over_its_time_is_rejected(tmp_path: Path, sandbox: Sandbox) -> None:
    """An endless constructor costs no more than the limit."""
    source = candidate("return x", "while True: pass")
    found = gate(sandbox.run, tmp_path, probe_limits=Limits(seconds=2.0, memory_mib=1_000)).inspect(source)
    assert isinstance(found, Rejection)
    assert found.reason is Reason.out_of_time


def test_sandboxed_probe_measures(tmp_path: Path, sandbox: Sandbox) -> None:
    """The same figures as in test_gate_probe.py come through the sandbox and the store."""
    for _ in range(2):
        found = gate(sandbox.run, tmp_path).inspect(VALID)
        assert isinstance(found, Admitted)
        assert (found.profile.parameters, found.profile.flops, found.profile.modules) == (127, 194_424, 3)


@needs_shared
@pytest.mark.parametrize("image_size", [32, 64])
@pytest.mark.parametrize("example", examples("llm_answers"), ids=lambda example: example["file"])
def test_real_answer_gets_its_verdict(tmp_path: Path, sandbox: Sandbox, example: Json, image_size: int) -> None:
    """What trains in a plain process is admitted, with as many parameters; the rest is rejected."""
    task = contract(example["task"], image_size)
    found = gate(sandbox.run, tmp_path, task=task).admit(completion(example["response"], example["stop_reason"]))
    assert isinstance(found, Admitted) == example["trains_at"][str(image_size)]
    if isinstance(found, Admitted):
        assert found.profile.parameters == example["parameters"]


@needs_shared
@pytest.mark.timeout(60)
@pytest.mark.parametrize("example", examples("hostile"), ids=lambda example: example["id"])
def test_attack_gets_its_verdict(tmp_path: Path, sandbox: Sandbox, example: Json) -> None:
    """What must be rejected is, harmless oddities are admitted, and the rest may be either but never an error."""
    limits = Limits(seconds=4.0, memory_mib=1_000)
    found = gate(sandbox.run, tmp_path, probe_limits=limits).admit(completion(example["source"]))
    match example["expected"]:
        case "reject_static":
            assert isinstance(found, Rejection)
            assert found.stage in (Stage.extract, Stage.policy)
        case "reject_probe":
            assert isinstance(found, Rejection)
        case "allowed_harmless":
            assert isinstance(found, Admitted)
