"""Promise: under portable numerics the same bits on every CPU, and what cannot keep it is known and flagged.

What runs under an emulator carries the marker `portable`; what proves that enough is computed there runs always, as do
comparisons with recorded bits. No emulator has AVX-512, so these are all that there is for `portable512`.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
import torch
from checkout import ROOT
from forms import forms, forms_of_answers
from gate_cases import needs_shared
from torch import nn

from tacevo.choices import Numerics
from tacevo.environment import machine
from tacevo.errors import ConfigError
from tacevo.gate.kernels import KernelWatcher
from tacevo.gate.operations import NOT_PORTABLE
from tacevo.gate.policy import allowed
from tacevo.gate.policy.check import rejection_of
from tacevo.reproduce.bits.compare import LEVELS, _cache, compare, recorded, report
from tacevo.reproduce.bits.expressions import expressions, names
from tacevo.reproduce.bits.networks import SOURCES, candidates
from tacevo.reproduce.bits.operations import computed
from tacevo.sandbox.caches import VARIABLE
from tacevo.training.numerics import check_machine, environment

CPUS = ("Haswell", "EPYC-Milan", "Skylake-Server")

#: What a candidate may name that computes something, by module.
MODULES = {
    "torch": torch,
    "torch.nn": nn,
    "torch.nn.functional": nn.functional,
    "torch.nn.init": nn.init,
    "torch.nn.utils": nn.utils,
    "torch.nn.utils.parametrizations": nn.utils.parametrizations,
    "torch.linalg": torch.linalg,
    "torch.fft": torch.fft,
    "torch.special": torch.special,
}

#: A host that offers less, as far as the numeric settings leave that open: to the C library, NumPy and its BLAS.
LESSER = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F,-AVX2_Usable,-FMA_Usable",
    "NPY_DISABLE_CPU_FEATURES": "AVX512_SPR AVX512_ICL AVX512_SKX X86_V4 X86_V3 AVX2 FMA3",
    "OPENBLAS_CORETYPE": "Nehalem",
}

#: What qemu 7.2 computes wrongly, by far more than a last bit: its gather instruction, so this says nothing of CPUs.
MISCOMPUTED = {"F.grid_sample(i, g)"}

#: Digests of `portable_printing.steps` on an Intel Xeon (family 6, model 167), with 32, 64 and 128 pixels.
XEON = {
    Numerics.portable: ["dec0867701199139", "08ff64a234ec4dc0", "240b16a177c3ed20"],
    Numerics.portable512: ["c2211a064d7f1b29", "803d705e9b929bf3", "41820f2d9feb07ed"],
}

#: Recorded digests that no CPU computes: of a training, of an operation, and of one that flags its candidate.
OTHERS = dict.fromkeys(["plain: training", "torch.add(x, y)", "torch.linalg.cholesky(h)"], "0" * 16)

DOCUMENT = ROOT / "docs" / "determinism.md"

portable = pytest.mark.portable
#: A candidate may call what torch would rather have called otherwise.
deprecated = pytest.mark.filterwarnings("ignore")
unhurried = pytest.mark.timeout(7_200)


@pytest.fixture
def _refusing() -> Iterator[None]:
    """Refuse what has no deterministic form, as a trainer does, for the length of a test."""
    before = torch.get_deterministic_debug_mode()
    torch.set_deterministic_debug_mode("error")
    with torch.random.fork_rng(devices=[]):
        yield
    torch.set_deterministic_debug_mode(before)


def printed(
    job: str,
    *emulator: str,
    numerics: Numerics = Numerics.portable,
    variables: Mapping[str, str] | None = None,
    check: bool = True,
) -> dict[str, str]:
    """Do a job in a process of its own under portable numerics; return the digest of each thing that it computed."""
    module = job.partition(".")[0]
    command = [*emulator, sys.executable, "-W", "ignore", "-c", f"import {module}; {job}()"]
    fixed = {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONHASHSEED": "0"}
    process = subprocess.run(
        command,
        env={**fixed, **environment(numerics), **(variables or {})},
        stdout=subprocess.PIPE,
        text=True,
        check=check,
    )
    return dict(json.loads(line) for line in process.stdout.splitlines())


def emulating(cpu: str) -> list[str]:
    """Return the words that emulate a CPU, where that can be done."""
    emulator = shutil.which("qemu-x86_64")
    if emulator is None:
        pytest.skip("qemu-x86_64 is not installed (package qemu-user)")
    return [emulator, "-cpu", cpu]


def survived(*emulator: str) -> dict[str, str]:
    """Compute every operation, in another process where one crashes, as emulators do now and then.

    An expression that crashes a process which has computed nothing else is `crashed`.
    """
    waiting = list(expressions())
    digests: dict[str, str] = {}
    while len(digests) < len(waiting):
        further = printed("portable_printing.operations", *emulator, check=False, variables={"SKIP": str(len(digests))})
        digests |= further or {waiting[len(digests)]: "crashed"}
    return digests


def able(numerics: Numerics) -> None:
    """Skip a test on a machine without the instructions that these numerics need."""
    try:
        check_machine(numerics)
    except ConfigError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def native() -> dict[str, str]:
    """Return what this machine computes of networks and runs."""
    return printed("portable_jobs.networks")


def table(differing: list[str]) -> str:
    """Write the table of docs/determinism.md: the kernels behind the expressions that differed."""
    rows: dict[str, list[str]] = {}
    for expression in differing:
        with KernelWatcher() as watcher:
            computed(expression)
        for kernel in sorted(watcher.not_portable) or ["not known"]:
            rows.setdefault(kernel, []).append(f"`{expression}`")
    lines = [f"| `{kernel}` | {', '.join(levels)} |" for kernel, levels in sorted(rows.items())]
    return "\n".join(["| kernel | measured to differ |", "|---|---|", *lines])


@portable
@unhurried
@pytest.mark.parametrize("cpu", CPUS)
def test_another_cpu_gives_the_same_bits(cpu: str, native: dict[str, str]) -> None:
    """Probes, trainings, losses, descriptors, simulated images, centroids, ledger, archives and tables."""
    assert printed("portable_jobs.networks", *emulating(cpu)) == native


@portable
@unhurried
def test_lesser_host_gives_the_same_bits(native: dict[str, str]) -> None:
    """The host's own limits, where the numeric settings do not set them already."""
    assert printed("portable_jobs.networks", variables=LESSER) == native


@portable
def test_lesser_host_is_one() -> None:
    """The C library, NumPy and its BLAS each compute other bits there, or name an older CPU."""
    here, there = printed("portable_jobs.surroundings"), printed("portable_jobs.surroundings", variables=LESSER)
    assert here.keys() == there.keys() == {"C library", "NumPy", "BLAS"}
    assert all(here[name] != there[name] for name in here)


@portable
@unhurried
@deprecated
@pytest.mark.usefixtures("_refusing")
def test_operations_that_differ_are_flagged_and_documented() -> None:
    """Each expression that gives other bits runs a flagged kernel, and the table names each flagged kernel."""
    here, there = survived(), survived(*emulating("Haswell"))
    assert list(there) == list(here) == list(expressions())
    assert "crashed" not in {*here.values(), *there.values()}
    differing = [name for name in here if there[name] != here[name] and name not in MISCOMPUTED]
    rows = table(differing)
    assert "not known" not in rows
    documented = DOCUMENT.read_text(encoding="utf-8")
    for kernel in NOT_PORTABLE:
        assert f"| `{kernel}` |" in rows, rows
        assert f"| `{kernel}` |" in documented, f"put this table into docs/determinism.md:\n{rows}"


def test_this_cpu_gives_the_recorded_bits(tmp_path: Path) -> None:
    """Trainings, convolutions and all operations, as recorded on another CPU; flagged operations may differ.

    What another torch computes is written beside, to become the golden files.
    """
    compared = compare()
    for each in compared:
        text = json.dumps(dict(each.digests), indent=1)
        (tmp_path / f"{each.level}.json").write_text(f"{text}\n", encoding="utf-8")
    assert any(each.reason is None for each in compared) or machine()["architecture"] != "x86_64"
    for each in compared:
        assert not each.status, f"{each}: {each.last_line}"
        assert each.reason is not None or each.digests.keys() == recorded(each.level).keys(), f"compare {tmp_path}"
        assert each.is_sound, f"{machine()['cpu']}: {each}; its bits are in {tmp_path}"


def test_other_bits_are_told_from_flagged_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """A training that differs breaks the promise; an operation that flags its candidate does not; neither is hidden."""
    able(Numerics.portable)
    monkeypatch.setattr("tacevo.reproduce.bits.compare.recorded", lambda level: recorded(level) | OTHERS)
    (here,) = compare([Numerics.portable])
    assert list(here.differing) == ["plain: training", "torch.add(x, y)"]
    assert list(here.flagged) == ["torch.linalg.cholesky(h)"]
    assert f"2 of {len(here.digests)} results differ from the record: plain: training, torch.add(x, y)" in str(here)
    written = json.loads(json.dumps(report([here])))["levels"]["portable"]
    assert written["digests"] == dict(here.digests)
    assert written["differing"] == list(here.differing)


def test_process_that_dies_is_no_obstacle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A CPU that cannot do what its settings ask for breaks the promise, and what it said last is in no report."""
    able(Numerics.portable)
    dying = "import os, signal\nos.write(2, b'lost in /home/someone')\nos.kill(os.getpid(), signal.SIGILL)\n"
    (tmp_path / "torch.py").write_text(dying)
    monkeypatch.syspath_prepend(tmp_path)
    (here,) = compare([Numerics.portable])
    assert (here.reason, here.status, here.is_sound) == (None, -signal.SIGILL, False)
    assert here.last_line == "lost in /home/someone"
    written = json.loads(json.dumps(report([here])))["levels"]
    assert "someone" not in json.dumps(written)


def test_cache_that_tells_no_size_is_described(tmp_path: Path) -> None:
    """As some virtual machines have it."""
    (tmp_path / "level").write_text("2\n")
    (tmp_path / "type").write_text("Unified\n")
    assert _cache(tmp_path) == ("L2 Unified", "unknown")


def test_levels_compute_with_kernels_of_their_own() -> None:
    """So one level's bits do not stand for the other's, and both are recorded for the same things."""
    lesser, greater = map(recorded, LEVELS)
    assert lesser.keys() == greater.keys()
    assert (lesser["kernels of ATen"], greater["kernels of ATen"]) == ("AVX2", "AVX512")
    trainings = [what for what in lesser if what.endswith(": training")]
    assert len(trainings) == 15
    assert sum(lesser[what] != greater[what] for what in trainings) > 10


@pytest.mark.parametrize(
    ("numerics", "other"),
    [
        (Numerics.portable512, "49152,524288,2097152"),  # Intel's Ice Lake for clients
        pytest.param(Numerics.portable512, "49152,2097152,1966080", marks=pytest.mark.slow),  # its Sapphire Rapids
        pytest.param(Numerics.portable, "32768,262144,2097152", marks=pytest.mark.slow),  # its Haswell
    ],
)
def test_caches_of_the_cpu_decide_nothing(numerics: Numerics, other: str) -> None:
    """On a CPU with other caches the convolutions have the recorded bits, which they do not have by themselves."""
    able(numerics)
    expected = {what: bits for what, bits in recorded(numerics).items() if what.startswith("convolution")}

    def convolved(job: str, variables: Mapping[str, str]) -> dict[str, str]:
        return {what: bits[:16] for what, bits in printed(job, numerics=numerics, variables=variables).items()}

    assert convolved("portable_printing.elsewhere", {"OTHER": other}) == expected
    assert convolved("portable_printing.convolutions", {VARIABLE: other}) != expected


@pytest.mark.slow
@pytest.mark.parametrize("numerics", LEVELS)
def test_another_cpu_with_avx512_gave_the_same_bits(numerics: Numerics) -> None:
    """An Intel Xeon computed these steps at both levels, as well as an AMD EPYC."""
    able(numerics)
    assert [bits[:16] for bits in printed("portable_printing.steps", numerics=numerics).values()] == XEON[numerics]


def test_caches_are_not_set_in_an_unknown_process() -> None:
    """Where torch's library is not found, the user is told, and nothing is computed with other bits."""
    command = [sys.executable, "-c", "from tacevo.sandbox.caches import pin; pin([32768, 1048576, 2097152])"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "install the torch of torch.lock, or set numerics=fast" in done.stderr


def test_every_allowed_name_is_computed() -> None:
    """Whatever a candidate may call of torch is in an expression, or is known to compute nothing."""
    offered = {name for path, module in MODULES.items() for name in dir(module) if allowed.is_allowed(path, name)}
    assert len(offered) > 500
    assert sorted(offered - names()) == []


@needs_shared
def test_networks_hold_every_form_of_answers() -> None:
    """The networks that are trained under emulation use all that recorded answers use."""
    held = frozenset().union(*(forms(source) for _, source, _ in candidates()))
    wanted = forms_of_answers()
    assert {"conv2d dilation", "multiheadattention", "einsum"} <= wanted
    assert sorted(wanted - held) == []


@pytest.mark.slow
@deprecated
@pytest.mark.usefixtures("_refusing")
def test_every_expression_can_be_computed() -> None:
    """None of them raises, and torch refuses those alone that have no deterministic form."""
    refused = {expression for expression in expressions() if computed(expression) == "refused"}
    assert len(refused) == 6
    assert all("unpool" in expression.lower() for expression in refused)


@pytest.mark.room("grammar")
def test_networks_hold_every_form_of_the_grammar() -> None:
    """They use all that the grammar's records can say."""
    from grammar_forms import forms_of_grammar

    held = frozenset().union(*(forms(source) for _, source, _ in candidates()))
    wanted = forms_of_grammar()
    assert {"conv2d groups", "groupnorm", "silu", "dropout2d", "hardtanh"} <= wanted
    assert sorted(wanted - held) == []


def test_networks_are_twelve_that_the_policy_admits() -> None:
    """Beside the three baselines; what the gate refuses would prove nothing."""
    networks = list(candidates())
    assert len(networks) == 3 + 12
    assert len(list(SOURCES.iterdir())) == 12
    assert [rejection_of(source, task) for _, source, task in networks] == [None] * 15
