"""Promise: an evaluation depends on its key alone, labels stay in the parent, and no answer of a child is believed."""

import hashlib
import json
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from training_jobs import CONTRACT, RECIPE, SOURCE, Recorder, examples, labelled

from tacevo.choices import Device, Numerics, Precision
from tacevo.errors import CacheMissError, ConfigError, DataError, SandboxError
from tacevo.records import Contract, Gpu, Limits, Loss, Mode, Reason, Rejection, Stage, Training
from tacevo.sandbox.caches import VARIABLE
from tacevo.sandbox.client import Died, Finished, Frame, RunJob, Sandbox
from tacevo.sandbox.kernel import can_fix_addresses
from tacevo.storage.store import Store
from tacevo.training.answers import judge
from tacevo.training.evaluation import ENTRIES, Evaluator, Setting
from tacevo.training.numerics import check_cpu, check_machine, environment

pytestmark = pytest.mark.timeout(120)

DATA = examples()
EXAMPLES = labelled(DATA)

#: Optimiser steps of an epoch.
STEPS = 8
WEIGHTS = "0" * 64


GPU = Gpu(model="NVIDIA H200", precision=Precision.float32, memory_mib=8192)

#: Each differs from the first in one thing.
GPUS = [GPU, replace(GPU, model="B"), replace(GPU, precision=Precision.bf16), replace(GPU, memory_mib=64)]


def evaluator(run: RunJob, root: Path, **changes: Any) -> Evaluator:
    """Make an evaluator of the tiny task, with some arguments changed."""
    store = Store(root, "evaluations", changes.pop("mode", Mode.record))
    examples, rules = changes.pop("examples", EXAMPLES), changes.pop("rules", 1)
    setting = Setting(contract=CONTRACT, fingerprint="abc", recipe=RECIPE, numerics=Numerics.portable)
    return Evaluator(run=run, store=store, setting=replace(setting, **changes), examples=examples, rules=rules)


def open_sandbox(folder: Path) -> Sandbox:
    """Open a sandbox with the images of the tiny task."""
    images = folder / "images.npy"
    np.save(images, DATA.images)
    entries = {**ENTRIES, "look": "training_jobs:look_at_torch"}
    return Sandbox(entries=entries, environment=environment(Numerics.portable), arrays={"images": images})


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sandbox]:
    """Open one sandbox for all trainings."""
    with open_sandbox(tmp_path_factory.mktemp("sandbox")) as opened:
        yield opened


def never(entry: str, header: Any, payload: bytes, limits: Limits, *_: object) -> Finished | Died:
    """Refuse to train."""
    raise SandboxError("nothing may be trained here")


def good_answer(predictions: np.ndarray[Any, Any]) -> Finished:
    """Write what a trainer sends that predicts the same after every epoch."""
    headers = [{"epoch": epoch, "train_loss": 0.5, "steps": STEPS * (epoch + 1)} for epoch in range(RECIPE.epochs)]
    frames = [Frame(header, predictions.tobytes()) for header in headers]
    return Finished((*frames, Frame({"weights_sha256": WEIGHTS}, b"")))


PERFECT = good_answer(EXAMPLES.validation_targets)
GOOD = PERFECT.frames


def judged(outcome: Finished, *, device: Device = Device.cpu, contract: Contract = CONTRACT) -> Training | Rejection:
    """Judge an answer; the labels of a classification are all 0."""
    targets = EXAMPLES.validation_targets if contract is CONTRACT else np.zeros(8, np.int64)
    steps: Any = {"epochs": RECIPE.epochs, "steps": STEPS, "rows": 8}
    verdict = judge(outcome, contract, targets, **steps, device=device)
    return verdict if isinstance(verdict, Rejection) else verdict[0]


def reason_of(outcome: Finished, device: Device = Device.cpu) -> Reason | None:
    """Return why an answer is refused; None where it is not."""
    verdict = judged(outcome, device=device)
    return verdict.reason if isinstance(verdict, Rejection) else None


def naming(not_deterministic: Any) -> Finished:
    """Write an answer that is good, and names operations without a deterministic form."""
    last = Frame({"weights_sha256": WEIGHTS, "not_deterministic": not_deterministic}, b"")
    return Finished((*GOOD[:-1], last))


def test_trivial_target_is_learnt(sandbox: Sandbox, tmp_path: Path) -> None:
    """The validation loss, computed from the child's predictions, falls clearly below the labels' variance."""
    verdict = evaluator(sandbox.run, tmp_path).evaluate(SOURCE, 0)
    assert isinstance(verdict, Training)
    assert verdict.validation_losses[-1] < EXAMPLES.validation_targets.var() / 2
    assert len(verdict.train_losses) == len(verdict.validation_losses) == RECIPE.epochs


def test_threads_give_what_one_by_one_gives(sandbox: Sandbox, tmp_path: Path) -> None:
    """The number of trainings at once changes no bit, and each seed gives its own."""
    serial = [evaluator(sandbox.run, tmp_path / "a").evaluate(SOURCE, seed) for seed in range(3)]
    together = evaluator(sandbox.run, tmp_path / "b")
    with ThreadPoolExecutor(3) as pool:
        assert list(pool.map(lambda seed: together.evaluate(SOURCE, seed), range(3))) == serial
    assert len({verdict.weights_sha256 for verdict in serial if isinstance(verdict, Training)}) == 3


def look(sandbox: Sandbox) -> Any:
    """Give what a candidate sees of torch."""
    finished = sandbox.run("look", None, b"", RECIPE.limits)
    assert isinstance(finished, Finished), finished
    return finished.frames[0].header


def test_two_sandboxes_give_equal_bits(sandbox: Sandbox, tmp_path: Path) -> None:
    """Nothing of a process enters a training; the mapped libraries lie alike, what is made on the heap may move."""
    first = evaluator(sandbox.run, tmp_path / "a").evaluate(SOURCE, 0)
    with open_sandbox(tmp_path) as other:
        assert evaluator(other.run, tmp_path / "b").evaluate(SOURCE, 0) == first
        mapped = [[place for place in look(one)["addresses"] if place > 0x7000_0000_0000] for one in (other, sandbox)]
    assert mapped[0]
    assert mapped[0] == mapped[1] or not can_fix_addresses()


def test_portable_child_computes_with_avx2_in_one_thread(sandbox: Sandbox) -> None:
    """The variables reach torch before it chooses its kernels; oneDNN and MKL, which do not say it, get theirs."""
    seen = look(sandbox)
    assert (seen["capability"], seen["threads"]) == ("AVX2", 1)
    fast = environment(Numerics.fast)
    for numerics, aten, onednn in (
        (Numerics.portable, "avx2", "AVX2"),
        (Numerics.portable512, "avx512", "AVX512_CORE"),
    ):
        others = {
            "ATEN_CPU_CAPABILITY": aten,
            "ONEDNN_MAX_CPU_ISA": onednn,
            "MKL_CBWR": "COMPATIBLE",
            "MKL_VML_DEBUG_CPU_TYPE": "0",
        }
        assert environment(numerics) == fast | others | {VARIABLE: "32768,1048576,2097152"} != fast
    of_both = {name: value for name, value in fast.items() if "CUDA" not in name}
    assert environment(Numerics.fast, Device.cuda) == of_both | {"CUBLAS_WORKSPACE_CONFIG": ":4096:8"}
    assert fast.keys() - of_both.keys() == {"CUDA_VISIBLE_DEVICES", "PYTORCH_NVML_BASED_CUDA_CHECK"}


@pytest.mark.slow
def test_fast_child_computes_with_all_that_the_cpu_has() -> None:
    """A confined process cannot read what the CPU can do, so it has been read before."""
    command = [sys.executable, "-c", "import torch; print(torch.backends.cpu.get_cpu_capability())"]
    plain = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    entries = {**ENTRIES, "look": "training_jobs:look_at_torch"}
    with Sandbox(entries=entries, environment=environment(Numerics.fast), arrays={}) as fast:
        assert look(fast)["capability"] == plain


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("while True: pass", Reason.out_of_time),
        ("raise SystemExit(0)", Reason.crashed),
        ("self.huge = torch.ones(2**27)", Reason.out_of_memory),
        ("raise ValueError('\\x1b no')", Reason.construction_failed),
    ],
)
def test_failed_training_is_a_rejection(sandbox: Sandbox, tmp_path: Path, line: str, reason: Reason) -> None:
    """Whatever ends a training early arrives as a typed value, and is stored as such."""
    broken = SOURCE.replace("super().__init__()", f"super().__init__()\n        {line}")
    seconds = 2 if reason is Reason.out_of_time else 20
    recipe = replace(RECIPE, limits=Limits(seconds=seconds, memory_mib=400))
    verdict = evaluator(sandbox.run, tmp_path, recipe=recipe).evaluate(broken, 0)
    assert isinstance(verdict, Rejection)
    assert (verdict.stage, verdict.reason) == (Stage.train, reason)
    assert evaluator(never, tmp_path, recipe=recipe, mode=Mode.replay).evaluate(broken, 0) == verdict


def test_second_evaluation_is_recalled(tmp_path: Path) -> None:
    """Equal questions are asked once; in replay neither data nor sandbox is needed."""
    first = evaluator(Recorder(PERFECT).run, tmp_path).evaluate(SOURCE, 0)
    assert evaluator(never, tmp_path).evaluate(SOURCE, 0) == first
    assert evaluator(never, tmp_path, examples=None, mode=Mode.replay).evaluate(SOURCE, 0) == first


def test_everything_that_matters_enters_the_key(tmp_path: Path) -> None:
    """Source, seed, data, contract, recipe and numerics each give another key."""
    base = evaluator(never, tmp_path)
    keys = {
        base.key(SOURCE, 0),
        base.key(SOURCE + "\n", 0),
        base.key(SOURCE, 1),
        evaluator(never, tmp_path, examples=None, fingerprint="other").key(SOURCE, 0),
        evaluator(never, tmp_path, contract=replace(CONTRACT, outputs=1)).key(SOURCE, 0),
        evaluator(never, tmp_path, recipe=replace(RECIPE, epochs=9)).key(SOURCE, 0),
        evaluator(never, tmp_path, numerics=Numerics.fast).key(SOURCE, 0),
        evaluator(never, tmp_path, device=Device.cuda).key(SOURCE, 0),
        *(evaluator(never, tmp_path, recipe=replace(RECIPE, gpu=gpu)).key(SOURCE, 0) for gpu in GPUS),
    }
    assert len(keys) == 8 + len(GPUS)
    assert evaluator(never, tmp_path, device=Device.cpu).key(SOURCE, 0) == base.key(SOURCE, 0)


def test_question_of_a_search_stays_what_it_was(tmp_path: Path) -> None:
    """Key and message are pinned byte by byte: another one would train every recorded candidate again."""
    recorder = Recorder(PERFECT)
    search = evaluator(recorder.run, tmp_path)
    search.evaluate(SOURCE, 0)
    ((header, payload),) = recorder.sent
    assert search.key(SOURCE, 0) == "b87fc6e42afd5b586f5db1aed2dd132db44554380d4323d0f9c36586ab5c1c9b"
    sent = hashlib.sha256(json.dumps(header).encode() + payload).hexdigest()
    assert sent == "0feb1811df050dce7212799bfd1b84d53702245ceb01a50362347b0bec0608e9"


def test_operations_without_a_deterministic_form_are_kept() -> None:
    """What the child reports of them on a GPU reaches the record."""
    verdict = judged(naming(["aten::pool", "unpool_2d.out"]), device=Device.cuda)
    assert isinstance(verdict, Training)
    assert verdict.not_deterministic == ("aten::pool", "unpool_2d.out")


def test_operation_without_a_deterministic_form_is_forged_on_a_cpu(tmp_path: Path) -> None:
    """A CPU runs none, so whoever names one has written the answer himself: not even a good name reaches the store."""
    assert reason_of(naming(["pool"])) is Reason.bad_output
    assert reason_of(naming([])) is None
    forged = evaluator(lambda *_: naming(["# Winner: [me](http://x)"]), tmp_path)
    assert isinstance(forged.evaluate(SOURCE, 0), Rejection)
    assert all("Winner" not in path.read_text() for path in tmp_path.rglob("*.json"))


@pytest.mark.parametrize(
    "names",
    [
        *("pool", [3], None, [""], ["a" * 101], ["# Winner"], ["[me](http://x)"], ["pool\n"], ["p\u00f6\u00f6l"]),
        *(["pool", "pool"], ["pool", "conv"], [f"op{number:03}" for number in range(101)]),
    ],
    ids=range(12),
)
def test_list_of_operations_is_no_place_for_text(names: Any) -> None:
    """On a GPU the list is the child's claim; short plain names pass, each once and in order, and nothing else."""
    assert reason_of(naming(names), Device.cuda) is Reason.bad_output


def test_retraining_asks_no_store(tmp_path: Path) -> None:
    """A recorded answer is neither read nor replaced."""
    recorder = Recorder(PERFECT)
    again = evaluator(recorder.run, tmp_path)
    first = again.evaluate(SOURCE, 0)
    entries = {path: path.read_bytes() for path in tmp_path.rglob("*.json")}
    assert again.retrain(SOURCE, 0) == first
    assert len(recorder.sent) == 2
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.json")} == entries
    missing = evaluator(recorder.run, tmp_path / "other")
    missing.retrain(SOURCE, 0)
    assert not (tmp_path / "other").exists()


def test_validation_labels_never_leave_the_parent(tmp_path: Path) -> None:
    """What is sent does not change with the validation labels, and does not contain them."""
    first, second = Recorder(PERFECT), Recorder(PERFECT)
    evaluator(first.run, tmp_path / "a").evaluate(SOURCE, 0)
    other = replace(EXAMPLES, validation_targets=1 - EXAMPLES.validation_targets)
    evaluator(second.run, tmp_path / "b", examples=other).evaluate(SOURCE, 0)
    assert first.sent == second.sent
    ((header, payload),) = first.sent
    assert all(row.tobytes() not in payload for row in EXAMPLES.validation_targets)
    assert set(header) == {"source", "contract", "recipe", "seed", "mean", "deviation", "train", "validation"}


def test_device_and_what_older_trainings_had_are_sent_beside_what_a_search_sends(tmp_path: Path) -> None:
    """The latter is in no key, because the number of the rules, which the key has, says the same."""
    recorder = Recorder(PERFECT)
    older = {"contiguous": True, "mkl_functions": True}
    new, old, gpu = (evaluator(recorder.run, tmp_path, **change) for change in ({}, older, {"device": Device.cuda}))
    for one in (new, old, gpu):
        one.retrain(SOURCE, 0)
    (header, payload), *others = recorder.sent
    assert others == [({**header, **older}, payload), ({**header, "device": "cuda"}, payload)]
    assert old.key(SOURCE, 0) == new.key(SOURCE, 0)


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        pytest.param({}, SandboxError, id="broken sandbox"),
        pytest.param({"examples": None, "mode": Mode.replay}, CacheMissError, id="miss in a replay"),
        pytest.param({"examples": None}, DataError, id="no data"),
        pytest.param({"fingerprint": "other"}, ValueError, id="a key that names other data"),
    ],
)
def test_what_cannot_be_trained_is_an_error_and_never_stored(
    changes: dict[str, Any], error: type[Exception], tmp_path: Path
) -> None:
    """No verdict follows from it."""
    with pytest.raises(error):
        evaluator(never, tmp_path, **changes).evaluate(SOURCE, 0)
    assert list(tmp_path.rglob("*.json")) == []


def test_loss_comes_from_the_labels_of_the_parent() -> None:
    """Perfect predictions have none; equal logits over two classes cost log 2, in nine digits."""
    perfect = judged(PERFECT)
    assert isinstance(perfect, Training)
    assert perfect.validation_losses == (0.0,) * RECIPE.epochs
    undecided = good_answer(np.zeros((8, 2), np.float32))
    classified = judged(undecided, contract=replace(CONTRACT, loss=Loss.cross_entropy))
    assert isinstance(classified, Training)
    assert classified.validation_losses[-1] == 0.693147181


FIRST = {"epoch": 0, "train_loss": 0.5, "steps": STEPS}
PREDICTED = GOOD[0].payload


@pytest.mark.parametrize(
    "frames",
    [
        (),
        GOOD[:-1],
        GOOD[1:],
        (*GOOD, GOOD[-1]),
        (Frame(FIRST, b"123"), *GOOD[1:]),
        (Frame(FIRST, bytes(1000)), *GOOD[1:]),
        (Frame({**FIRST, "train_loss": "low"}, PREDICTED), *GOOD[1:]),
        (Frame({**FIRST, "steps": STEPS + 1}, PREDICTED), *GOOD[1:]),
        (Frame({"epoch": 0, "train_loss": 0.5}, PREDICTED), *GOOD[1:]),
        (Frame([], PREDICTED), *GOOD[1:]),
        (Frame(None, PREDICTED), *GOOD[1:]),
        (*GOOD[:-1], Frame({"weights_sha256": "zz"}, b"")),
        (*GOOD[:-1], Frame(3, b"")),
        (Frame({"rejection": {"reason": "no such reason", "detail": ""}}, b""),),
        (Frame({"rejection": 7}, b""),),
    ],
    ids=range(15),
)
def test_malformed_answer_is_a_bad_output(frames: tuple[Frame, ...]) -> None:
    """Frames that a trainer would not send are the candidate's, and count against it."""
    assert reason_of(Finished(frames)) is Reason.bad_output


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_predictions_that_are_not_finite_are_rejected(value: float) -> None:
    """One bad number after any epoch is enough."""
    predictions = EXAMPLES.validation_targets.copy()
    predictions[3, 1] = value
    assert reason_of(good_answer(predictions)) is Reason.not_finite


def test_detail_of_a_child_is_cleaned() -> None:
    """Text that a candidate forged cannot speak to a terminal or break a store."""
    verdict = judged(Finished((Frame({"rejection": {"reason": "crashed", "detail": "\x1b[2J" + "x" * 10_000}}, b""),)))
    assert isinstance(verdict, Rejection)
    assert verdict.detail.isprintable()
    assert len(verdict.detail) == 300


@pytest.mark.parametrize(
    ("machine", "cpuinfo"),
    [
        ("aarch64", "Features\t: asimd"),
        ("x86_64", "flags\t\t: fpu avx avx512f"),
        ("x86_64", "bugs: avx2"),
        ("x86_64", ""),
    ],
)
def test_portable_numerics_are_refused_where_they_cannot_hold(machine: str, cpuinfo: str) -> None:
    """A machine that computes otherwise is told before the search starts, with the way out."""
    with refused(ConfigError, expected="an x86_64 CPU with avx2", got=machine, remedy="set numerics=fast"):
        check_cpu(Numerics.portable, machine, cpuinfo)
    check_cpu(Numerics.fast, machine, cpuinfo)


AVX512 = ["avx2", "fma", "avx512f", "avx512bw", "avx512dq", "avx512vl"]


@pytest.mark.parametrize("missing", AVX512)
def test_portable512_is_refused_without_any_of_its_instructions(missing: str) -> None:
    """The error names what is missing, and what else can be done, also of a run that was recorded elsewhere."""
    held = " ".join(flag for flag in AVX512 if flag != missing)
    with refused(
        ConfigError, place="numerics=portable512", got=f"x86_64 without {missing}", remedy="without --retrain"
    ):
        check_cpu(Numerics.portable512, "x86_64", f"flags\t\t: fpu {held}\n")
    with refused(ConfigError, got="aarch64", remedy="set numerics=portable"):
        check_cpu(Numerics.portable512, "aarch64", f"flags\t\t: {' '.join(AVX512)}\n")
    check_cpu(Numerics.portable512, "x86_64", f"flags\t\t: {' '.join(AVX512)}\n")


def test_portable_numerics_are_granted_with_avx2() -> None:
    """Any x86-64 CPU that lists the flag will do."""
    check_cpu(Numerics.portable, "x86_64", "processor: 0\nflags\t\t: fpu avx avx2 bmi1\n")
    check_machine(Numerics.fast)
