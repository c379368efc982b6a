"""The gate joins extraction, policy and probe: each answer gets the verdict it deserves, and is probed once.

Some tests pass a fake sandbox in; those on real answers and attacks go through the real one.
"""

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gate_cases import VALID, candidate, completion, contract, examples, needs_shared
from refusals import refused

from tacevo.choices import Numerics
from tacevo.errors import CacheMissError, SandboxError, StoreError
from tacevo.evolution.descriptors import describe
from tacevo.gate.admission import DataImages, Gate, GateLimits
from tacevo.profile import Admitted, Graph, Node, Profile, Step
from tacevo.records import Limits, Mode, Reason, Rejection, Stage, to_json
from tacevo.rules import CURRENT
from tacevo.sandbox.client import Died, Finished, Frame, Sandbox
from tacevo.storage.store import Store, check_entry

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
    steps=(
        Step(op="conv2d", weighted=True, sources=((),), operands=((1, 3, 8, 8),), shape=(1, 4, 6, 6), kernel=(3, 3)),
        Step(op="relu", weighted=False, sources=((0,),), operands=((1, 4, 6, 6),), shape=(1, 4, 6, 6)),
    ),
    output=(1,),
)
ANSWER: Any = {"profile": to_json(PROFILE)}

Run = Callable[..., Finished | Died]


class FakeSandbox:
    """Gives every job the same outcome and keeps what it was asked."""

    def __init__(self, outcome: Finished | Died | Exception | None = None) -> None:
        self.outcome = outcome or sent(ANSWER)
        self.headers: list[Any] = []

    def run(self, entry: str, header: Any, payload: bytes, limits: Limits, *_: object) -> Finished | Died:
        """Answer as told."""
        assert (entry, payload, limits.memory_mib) == ("probe", b"", PROBE_LIMITS.memory_mib)
        self.headers.append(header)
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return self.outcome


def sent(*headers: Any) -> Finished:
    """Make the outcome of a child that sent these frames."""
    return Finished(tuple(Frame(header, b"") for header in headers))


def gate(run: Run, root: Path, *, mode: Mode = Mode.record, **changes: Any) -> Gate:
    """Make the gate of the force task, with some fields changed."""
    usual = Gate(
        run=run,
        store=Store(root, "probes", mode),
        answers=Store(root, "answers", mode),
        contract=contract(),
        limits=LIMITS,
        probe_limits=PROBE_LIMITS,
        numerics=Numerics.portable,
        rules=CURRENT,
    )
    return replace(usual, **changes)


def reason_of(verdict: Admitted | Rejection) -> Reason | None:
    """Return why a candidate was rejected; None where it was admitted."""
    return verdict.reason if isinstance(verdict, Rejection) else None


@pytest.fixture(scope="module")
def sandbox() -> Iterator[Sandbox]:
    """One real sandbox for all tests of this module."""
    environment = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    with Sandbox(entries={"probe": "tacevo.gate.probe:run"}, environment=environment, arrays={}) as opened:
        yield opened


def test_each_stage_rejects_in_its_turn(tmp_path: Path) -> None:
    """An answer that fails early never reaches the sandbox."""
    fake = FakeSandbox()
    verdicts = [gate(fake.run, tmp_path).admit(completion(text)) for text in ("", "import os\n" + VALID)]
    assert [(it.stage, it.reason) for it in verdicts if isinstance(it, Rejection)] == [
        (Stage.extract, Reason.empty),
        (Stage.policy, Reason.forbidden_import),
    ]
    assert fake.headers == []


def test_admitted_source_that_this_python_cannot_parse_is_measured_in_a_replay(tmp_path: Path) -> None:
    """Whoever recorded it had another version, whose policy admitted it."""
    source = f"{VALID}\nnot of this version ("
    gate(FakeSandbox().run, tmp_path).measure(source)
    nothing = FakeSandbox(SandboxError("a replay needs none"))
    assert gate(nothing.run, tmp_path, mode=Mode.replay).measure(source) == Admitted(source=source, profile=PROFILE)


def test_checked_text_is_the_text_that_runs(tmp_path: Path) -> None:
    """The sandbox and the caller get the very text that the policy saw."""
    fake = FakeSandbox()
    verdict = gate(fake.run, tmp_path).admit(completion(f"Here:\n```python\n{VALID}```"))
    assert verdict == Admitted(source=VALID, profile=PROFILE)
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
        {"contract": contract(image_size=64)},
        {"limits": replace(LIMITS, parameters=7)},
        {"limits": replace(LIMITS, flops=7)},
        {"limits": replace(LIMITS, modules=7)},
        {"probe_limits": replace(PROBE_LIMITS, seconds=90.0)},
        {"numerics": Numerics.fast},
        {"fingerprint": "of a data set"},
        {"source_bytes": 5_000},
    ],
)
def test_everything_that_can_change_a_verdict_enters_its_key(tmp_path: Path, change: dict[str, Any]) -> None:
    """A probe under one setting does not answer for another; the limit on raw text says nothing of a probe."""
    fake = FakeSandbox()
    gate(fake.run, tmp_path).inspect(VALID)
    gate(fake.run, tmp_path, **change).inspect(VALID)
    assert len(fake.headers) == (1 if "source_bytes" in change else 2)


def test_probe_under_older_rules_is_found_without_a_data_set(tmp_path: Path) -> None:
    """Its key has none: it saw no image."""
    older = replace(CURRENT, probe=6)
    gate(FakeSandbox().run, tmp_path, rules=older).measure(VALID)
    later = gate(FakeSandbox().run, tmp_path, mode=Mode.replay, rules=older, fingerprint="of a data set")
    assert later.measure(VALID) == Admitted(source=VALID, profile=PROFILE)


@pytest.mark.parametrize(("count", "first"), [(3, [0, 0, 0]), (16, [0, 1, 2]), (400, [0, 26, 53])])
def test_probe_sees_images_from_all_of_the_data(count: int, first: list[int]) -> None:
    """Sixteen of them, evenly; of fewer, some twice."""
    chosen = DataImages.of(np.arange(count), (1.0,), (2.0,)).rows
    assert (len(chosen), [*chosen[:3]], chosen[-1]) == (16, first, count - 1)


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
    assert isinstance(gate(FakeSandbox().run, tmp_path).inspect(VALID), Admitted)


def test_replay_asks_no_sandbox_and_reads_no_unknown_answer(tmp_path: Path) -> None:
    """A source without a recorded probe is an error, and so is an answer without a verdict."""
    fake = FakeSandbox()
    with refused(CacheMissError, got="no recorded answer for probes request"):
        gate(fake.run, tmp_path, mode=Mode.replay).inspect(VALID)
    assert fake.headers == []
    gate(fake.run, tmp_path).inspect(VALID)
    with refused(CacheMissError, got="no recorded answer for answers request"):
        gate(fake.run, tmp_path, mode=Mode.replay).admit(completion(VALID))


def forged(place: str, value: Any) -> Any:
    """Put another value into the answer at a place such as `graph.nodes.0.op`."""
    answer = json.loads(json.dumps(ANSWER["profile"]))
    *path, last = [int(part) if part.isdecimal() else part for part in place.split(".")]
    inner = answer
    for part in path:
        inner = inner[part]
    inner[last] = value
    return {"profile": answer}


def test_answer_is_read_once(tmp_path: Path) -> None:
    """The second gate recalls the verdict of extraction and policy, for a source and for a rejection."""
    for text in (VALID, "import os\n" + VALID, "no class"):
        fake = FakeSandbox()
        verdict = gate(fake.run, tmp_path).admit(completion(text))
        assert gate(fake.run, tmp_path, mode=Mode.replay).admit(completion(text)) == verdict
    assert len(list(Store(tmp_path, "answers").entries())) == 3


def test_replay_takes_the_recorded_verdict_on_an_answer(tmp_path: Path) -> None:
    """Python 3.12 parses what 3.11 refuses, so a replay believes the recording and not its own parser."""
    text = "an answer that another version of Python found to hold the source"
    request: Any = {
        "version": CURRENT.static,
        "text": text,
        "stop_reason": "end_turn",
        "contract": to_json(contract()),
        "limit": 100_000,
    }
    fake = FakeSandbox()
    assert isinstance(gate(fake.run, tmp_path).inspect(VALID), Admitted)
    Store(tmp_path, "answers").write(request, {"source": VALID})
    verdict = gate(fake.run, tmp_path, mode=Mode.replay).admit(completion(text))
    assert verdict == Admitted(source=VALID, profile=PROFILE)


def test_everything_that_can_change_the_reading_enters_its_key(tmp_path: Path) -> None:
    """Another text, stop reason, contract or limit is another question."""
    fake = FakeSandbox()
    gate(fake.run, tmp_path).admit(completion(VALID))
    gate(fake.run, tmp_path).admit(completion(VALID + "\n"))
    gate(fake.run, tmp_path).admit(completion(VALID, "max_tokens"))
    gate(fake.run, tmp_path, contract=contract(image_size=64)).admit(completion(VALID))
    gate(fake.run, tmp_path, source_bytes=5_000).admit(completion(VALID))
    assert len(list(Store(tmp_path, "answers").entries())) == 5


def test_given_network_that_is_repeated_before_other_code_is_no_answer(tmp_path: Path) -> None:
    """The request tells which networks a model was given, comments and spaces aside; a replay recalls it."""
    text = f"You gave:\n```python\n{VALID}```\nI'd have:\n```python\ndef forward(self, x):\n    return 2 * x\n```"
    asked = f"Change it:\n{VALID.replace('4, 3)', '4,  3)  # small')}"
    for mode in (Mode.live, Mode.replay):
        judge = gate(FakeSandbox().run, tmp_path, mode=mode)
        assert reason_of(judge.admit(completion(text), asked)) is Reason.no_class
        assert judge.admit(completion(text), "Make one.") == Admitted(source=VALID, profile=PROFILE)
        assert judge.admit(completion(VALID), asked) == Admitted(source=VALID, profile=PROFILE)


def test_rules_of_older_runs_admit_it(tmp_path: Path) -> None:
    """A replay of a run under them asks for no verdict that was not recorded."""
    text = f"```python\n{VALID}```\n```python\ndef forward(self, x):\n    return 2 * x\n```"
    request: Any = {
        "version": 2,
        "text": text,
        "stop_reason": "end_turn",
        "contract": to_json(contract()),
        "limit": 100_000,
    }
    answers = Store(tmp_path, "answers")
    answers.write(request, {"source": VALID})
    answers.write({**request, "version": 3}, {"source": VALID})
    said: Any = {"rejection": {"stage": "extract", "reason": "no_class", "detail": "as it was said"}}
    answers.write({**request, "version": 3, "own": False}, said)
    measured = gate(FakeSandbox().run, tmp_path)
    assert isinstance(measured.measure(VALID), Admitted)
    for static, reason in ((2, None), (3, Reason.no_class)):
        judge = gate(FakeSandbox().run, tmp_path, mode=Mode.replay, rules=replace(CURRENT, static=static))
        assert reason_of(judge.admit(completion(text), f"Change it:\n{VALID}")) is reason
        assert judge.admit(completion(text), "Make one.") == Admitted(source=VALID, profile=PROFILE)


def test_given_network_that_is_quoted_behind_the_new_one_is_not_the_child(tmp_path: Path) -> None:
    """What was asked enters the key, so a replay needs its store alone, and no other question is answered by it."""
    new = VALID.replace("4", "8")
    text = f"```python\n{new}```\nI was given:\n```python\n{VALID}```"
    asked = f"Change it:\n```python\n{VALID}```"
    for mode in (Mode.record, Mode.replay):
        judge = gate(FakeSandbox().run, tmp_path, mode=mode)
        assert judge.admit(completion(text), asked) == Admitted(source=new, profile=PROFILE)
        assert judge.admit(completion(text)) == Admitted(source=VALID, profile=PROFILE)
    with refused(CacheMissError, got="no recorded answer for answers request"):
        judge.admit(completion(text), f"{asked}\nMake it small.")
    assert len(list(Store(tmp_path, "answers").entries())) == 2


def test_what_was_changed_in_an_answer_is_said(tmp_path: Path) -> None:
    """In words, and in a comment of the source that is checked and runs."""
    judge = gate(FakeSandbox().run, tmp_path)
    answer = completion(f"```python\n@torch.compile\n{VALID}```")
    notes = judge.notes(answer)
    assert notes
    assert judge.admit(answer) == Admitted(source=f"# tacevo: {notes[0]}\n{VALID}", profile=PROFILE)
    assert judge.notes(completion(VALID)) == judge.notes(completion("no class")) == judge.notes(completion("")) == ()


@pytest.mark.parametrize(
    ("text", "reason"),
    [("x" * 101_000, Reason.too_long), ("\ud800", Reason.syntax), (" ", Reason.empty)],
    ids=["too long", "lone surrogate", "blank"],
)
def test_answer_that_needs_no_parsing_is_not_kept(tmp_path: Path, text: str, reason: Reason) -> None:
    """A huge answer would fill the disk and a lone surrogate cannot be written; a replay judges them again."""
    for mode in (Mode.record, Mode.replay):
        verdict = gate(FakeSandbox().run, tmp_path, mode=mode).admit(completion(text))
        assert isinstance(verdict, Rejection)
        assert (verdict.stage, verdict.reason) == (Stage.extract, reason)
    assert list(Store(tmp_path, "answers").entries()) == []


NODES, STEPS = ANSWER["profile"]["graph"]["nodes"], ANSWER["profile"]["steps"]

#: What no probe sends, with the place of the answer where it stands.
FORGED = [
    *(("parameters", value) for value in ("many", 0, True, 20_000_001)),
    *(("flops", value) for value in (-1, 10**400)),
    ("modules", 1_001),
    *(("not_portable", value) for value in (["everything"], ["sqrt", "sqrt"])),
    ("graph.nodes", NODES * 501),
    *(("graph.edges", value) for value in ([[1, 0]], [[0, 9]], [[0, 1], [0, 1]])),
    *(("graph.channels", value) for value in ([-4], [10**400], [4] * 3)),
    *(("graph.kernels", value) for value in ([float("nan")], [1e308, 1e308])),
    ("graph.nodes.0.op", "x" * 101),
    ("graph.nodes.0.width", 10**400),
    ("steps", STEPS[:1] * 5_001),
    *(("output", value) for value in ([2], [1, 0])),
    *(("steps.1.sources", value) for value in ([[1]], [[0, 0]], [[0], [0]])),
    ("steps.1", {**STEPS[1], "sources": [[0]] * 17, "operands": [[1]] * 17}),
    ("steps.1.shape", [10**400]),
    ("steps.1.stride", [-1]),
    ("steps.1.rate", 1.5),
    ("steps.1.op", "x" * 101),
]


@pytest.mark.parametrize(
    "headers",
    [
        pytest.param([], id="no frame"),
        pytest.param([ANSWER, ANSWER], id="two frames"),
        pytest.param([None], id="null"),
        pytest.param([{"rejection": {"stage": "probe", "reason": "bored", "detail": ""}}], id="unknown reason"),
        pytest.param([{"rejection": {"stage": "train", "reason": "crashed", "detail": ""}}], id="other stage"),
        *(pytest.param([forged(*change)], id=f"{change[0]} {str(change[1])[:20]}") for change in FORGED),
    ],
)
def test_forged_answer_is_a_crash(tmp_path: Path, headers: list[Any]) -> None:
    """A candidate can write frames of its own; what is not a probe's answer counts against it."""
    verdict = gate(FakeSandbox(sent(*headers)).run, tmp_path).inspect(VALID)
    assert isinstance(verdict, Rejection)
    assert (verdict.stage, verdict.reason) == (Stage.probe, Reason.crashed)


@pytest.mark.parametrize("change", [("output", [2]), ("steps.1.sources", [[1]]), ("graph.edges", [[0, 9]])])
def test_forged_entry_of_a_store_is_refused(tmp_path: Path, change: tuple[str, Any]) -> None:
    """A published store may hold indices that lead nowhere; readers of the profile would fail on them much later."""
    gate(FakeSandbox().run, tmp_path).inspect(VALID)
    (path,) = (tmp_path / "probes").rglob("*.json")
    entry = check_entry(path, path.read_bytes(), "probes", path.stem)
    Store(tmp_path, "probes").write(entry.request, forged(*change))
    with refused(StoreError, place="profile"):
        gate(FakeSandbox(SandboxError("no probe is wanted")).run, tmp_path).inspect(VALID)


def test_every_admitted_profile_has_finite_descriptors(tmp_path: Path) -> None:
    """The largest and smallest figures that a candidate can forge still have a place in the archive."""
    top = 2**53 - 1
    nodes = (Node(op="a", weighted=True, width=top), Node(op="b", weighted=True, width=0))
    graph = Graph(nodes=nodes, edges=((0, 1),), channels=(0, top), kernels=(5e-324, top), hidden=())
    huge = Profile(parameters=1, flops=top, modules=0, graph=graph)
    unlimited = GateLimits(parameters=top, flops=top, modules=top)
    verdict = gate(FakeSandbox(sent({"profile": to_json(huge)})).run, tmp_path, limits=unlimited).inspect(VALID)
    assert isinstance(verdict, Admitted)
    assert all(math.isfinite(value) and value >= 0 for value in astuple(describe(verdict.profile)))


def test_forged_detail_is_cut_to_one_line(tmp_path: Path) -> None:
    """A rejection's text is shown to a person; control characters and further lines would speak to the terminal."""
    loud = {"stage": "probe", "reason": "crashed", "detail": "\x1b[2Jgone\n" + "x" * 1_000}
    verdict = gate(FakeSandbox(sent({"rejection": loud})).run, tmp_path).inspect(VALID)
    assert verdict == Rejection(stage=Stage.probe, reason=Reason.crashed, detail="?[2Jgone")


def test_layer_of_width_zero_is_admitted_and_described(tmp_path: Path, sandbox: Sandbox) -> None:
    """What honest code such as `nn.Linear(4, 4 // 8)` gives passes the gate and has a place in the archive."""
    layers = "self.down = nn.Linear(4, 4 // 8)\nself.up = nn.Linear(4 // 8, 4)"
    source = candidate("h = self.conv(x).mean((2, 3))\nreturn self.head(h + self.up(self.down(h)))", layers)
    verdict = gate(sandbox.run, tmp_path).inspect(source)
    assert isinstance(verdict, Admitted), verdict
    assert verdict.profile.graph.hidden == (0, 4)
    assert describe(verdict.profile).variation == pytest.approx((0 + 1.0) / 3)


@pytest.mark.timeout(60)
def test_candidate_over_its_time_is_rejected(tmp_path: Path, sandbox: Sandbox) -> None:
    """An endless constructor costs no more than the limit."""
    source = candidate("return x", "while True: pass")
    judge = gate(sandbox.run, tmp_path, probe_limits=Limits(seconds=2.0, memory_mib=1_000))
    assert reason_of(judge.inspect(source)) is Reason.out_of_time


def test_seed_of_the_machine_is_told_in_our_words(tmp_path: Path, sandbox: Sandbox) -> None:
    """A generator would read it from a file, which a candidate cannot open; the message names no file."""
    init = "g = torch.Generator()\ng.seed()\nself.w = nn.Parameter(torch.rand(9, generator=g))"
    verdict = gate(sandbox.run, tmp_path).inspect(candidate("return self.head(self.conv(x).mean((2, 3)))", init))
    assert isinstance(verdict, Rejection)
    assert verdict.reason is Reason.fixed_seed
    assert "/dev" not in verdict.detail


@pytest.mark.few(12)
@needs_shared
@pytest.mark.parametrize("image_size", [32, 64])
@pytest.mark.parametrize("example", examples("llm_answers"), ids=lambda example: example["file"])
def test_real_answer_gets_its_verdict(tmp_path: Path, sandbox: Sandbox, example: Any, image_size: int) -> None:
    """What trains in a plain process is admitted, with as many parameters; the rest is rejected."""
    task = contract(example["task"], image_size)
    verdict = gate(sandbox.run, tmp_path, contract=task).admit(completion(example["response"], example["stop_reason"]))
    assert isinstance(verdict, Admitted) == example["trains_at"][str(image_size)]
    if isinstance(verdict, Admitted):
        assert verdict.profile.parameters == example["parameters"]
    else:
        assert verdict.stage is not Stage.policy


@needs_shared
@pytest.mark.timeout(60)
@pytest.mark.parametrize("example", examples("hostile"), ids=lambda example: example["id"])
def test_attack_gets_its_verdict(tmp_path: Path, sandbox: Sandbox, example: Any) -> None:
    """What must be rejected is, harmless oddities are admitted, and the rest may be either but never an error."""
    limits = Limits(seconds=4.0, memory_mib=1_000)
    verdict = gate(sandbox.run, tmp_path, probe_limits=limits).admit(completion(example["source"]))
    match example["expected"]:
        case "reject_static":
            assert isinstance(verdict, Rejection)
            assert verdict.stage in (Stage.extract, Stage.policy)
        case "reject_probe":
            assert isinstance(verdict, Rejection)
        case "allowed_harmless":
            # One loops over its batch and mixes neighbouring images, so five images are other work than one; and one
            # draws its weights from a seed of its own.
            assert isinstance(verdict, Admitted) or verdict.reason in {Reason.depends_on_batch, Reason.fixed_seed}
