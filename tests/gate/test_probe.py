"""The probe admits what trains and measures it; everything else gets the reason that fits.

These tests run `run` in this process, on harmless candidates only; test_admission.py goes through the sandbox.
"""

import pytest
import torch
from checkout import SHARED
from gate_cases import VALID, candidate, contract, needs_shared

from tacevo.gate.probe import run
from tacevo.profile import Profile
from tacevo.records import Contract, Json, Reason, Rejection, Stage, to_json
from tacevo.search.descriptors import describe
from tacevo.storage.verdicts import read_verdict

pytestmark = pytest.mark.usefixtures("torch_settings")

LIMITS = {"parameters": 10_000_000, "flops": 10**10, "modules": 100}


def probe(source: str, task: Contract, **limits: int) -> Profile | Rejection:
    """Run the probe and read its one frame."""
    frames: list[Json] = []
    header = {"source": source, "contract": to_json(task), "limits": {**LIMITS, **limits}}
    run(header, b"", {}, lambda frame, _: frames.append(frame))
    (answer,) = frames
    return read_verdict(Profile, "profile", answer, place="answer")


def profile_of(source: str, task: Contract | None = None, **limits: int) -> Profile:
    """Probe and insist on a profile."""
    found = probe(source, task or contract(), **limits)
    assert isinstance(found, Profile), found
    return found


def rejection_of(source: str, **limits: int) -> Rejection:
    """Probe and insist on a rejection at this stage."""
    found = probe(source, contract(), **limits)
    assert isinstance(found, Rejection)
    assert found.stage is Stage.probe
    return found


def test_valid_candidate_is_measured() -> None:
    """By hand: 4 x 3 x 9 + 4 weights and 3 x 4 + 3; 2 x 27 x 4 x 30 x 30 and 2 x 4 x 3 FLOPs; 3 modules."""
    profile = profile_of(VALID)
    assert profile.parameters == 112 + 15
    assert profile.flops == 2 * 27 * 4 * 30 * 30 + 2 * 4 * 3
    assert profile.modules == 3
    assert [node.op for node in profile.graph.nodes] == ["conv2d", "mean", "linear"]


@needs_shared
def test_baseline_is_the_worked_example() -> None:
    """At 64 pixels: three 3x3 convolutions on 64, 32 and 16 pixels, then 2048 to 512 to 3; two FLOPs a product.

    The descriptors are those of the worked example in docs/descriptors.md.
    """
    source = (SHARED / "llm_answers" / "baseline_force.py.txt").read_text(encoding="utf-8")
    products = 27 * 32 * 64**2 + 32 * 9 * 64 * 32**2 + 64 * 9 * 128 * 16**2 + 2048 * 512 + 512 * 3
    profile = profile_of(source, contract(image_size=64))
    assert profile.flops == 2 * products == 84_675_584
    assert profile.graph.channels == (32, 64, 128)
    assert profile.graph.hidden == (512,)
    found = describe(profile)
    assert found.entropy == pytest.approx(0.934978, abs=1e-6)
    assert found.density == 0.2
    assert found.variation == pytest.approx(0.178174, abs=1e-6)
    assert found.arch_div == pytest.approx(0.437717, abs=1e-6)
    assert found.eff_ratio == pytest.approx(0.722902, abs=1e-6)


def test_attention_is_counted() -> None:
    """By hand, 36 tokens of 4: three projections and one output, then two products of all pairs; and the rest."""
    forward = "t = self.conv(x).flatten(2).mT\nreturn self.head(self.attend(t, t, t)[0].mean(1))"
    source = candidate(forward, "self.attend = nn.MultiheadAttention(4, 2, batch_first=True)")
    attention = 2 * 36 * 4 * 4 * 4 + 2 * 2 * 36 * 36 * 4
    assert profile_of(source, contract(image_size=8)).flops == attention + 2 * 27 * 4 * 36 + 2 * 4 * 3


def test_classification_is_probed_with_its_own_loss() -> None:
    """Seven logits against seven classes."""
    source = VALID.replace("ImageRegressionCNN", "SingleLabelClassCNN").replace("num_outputs", "num_classes")
    assert profile_of(source, contract("grating")).parameters == 112 + 35


def test_limits_are_inclusive() -> None:
    """A candidate exactly as large as allowed is admitted, one unit more is not."""
    flops = profile_of(VALID).flops
    assert isinstance(probe(VALID, contract(), parameters=127, flops=flops, modules=3), Profile)
    assert rejection_of(VALID, parameters=126).reason is Reason.too_many_parameters
    assert rejection_of(VALID, flops=flops - 1).reason is Reason.too_many_flops
    assert rejection_of(VALID, modules=2).reason is Reason.too_many_modules


def test_operations_are_limited_too() -> None:
    """A loop can make a graph of any size from few modules."""
    source = candidate("for _ in range(200):\n    x = x + 1\nreturn self.head(self.conv(x).mean((2, 3)))")
    assert rejection_of(source).reason is Reason.too_many_modules


GOOD = "self.head(F.relu(self.conv(x)).mean((2, 3)))"


@pytest.mark.parametrize(
    ("reason", "source"),
    [
        pytest.param(Reason.construction_failed, "x = 1", id="no class"),
        pytest.param(Reason.construction_failed, "ImageRegressionCNN = 3", id="class is a number"),
        pytest.param(Reason.construction_failed, VALID.replace("(nn.Module)", ""), id="class is not a module"),
        pytest.param(Reason.construction_failed, VALID.replace("num_outputs=3", "width"), id="argument without value"),
        pytest.param(Reason.construction_failed, candidate("return x", "self.a = undefined"), id="unknown name"),
        pytest.param(Reason.forward_failed, candidate("return self.head(x)"), id="shapes do not fit"),
        pytest.param(Reason.forward_failed, candidate(f"assert len(x) != 5\nreturn {GOOD}"), id="one batch size"),
        pytest.param(Reason.forward_failed, candidate(f"assert self.training\nreturn {GOOD}"), id="train mode only"),
        pytest.param(Reason.bad_output, candidate("return self.conv(x).mean((2, 3))"), id="wrong width"),
        pytest.param(Reason.bad_output, candidate(f"return {GOOD}.double()"), id="wrong type"),
        pytest.param(Reason.bad_output, candidate(f"return [{GOOD}]"), id="list"),
        pytest.param(Reason.bad_output, candidate(f"return {GOOD}[:1]"), id="one row for all"),
        pytest.param(Reason.bad_output, candidate(f"return nn.Parameter({GOOD})"), id="subclass of tensor"),
        pytest.param(Reason.not_finite, candidate(f"return {GOOD} / 0"), id="infinite output"),
        pytest.param(Reason.not_finite, candidate(f"y = {GOOD}\nreturn (y - y).sqrt() + y"), id="infinite gradient"),
        pytest.param(
            Reason.not_finite,
            candidate(f"return {GOOD} + self.extra", "self.extra = nn.Parameter(torch.empty(3))"),
            id="weights never initialised",
        ),
        pytest.param(Reason.no_gradient, candidate(f"return {GOOD}.detach()"), id="detached"),
        pytest.param(Reason.no_gradient, candidate(f"return {GOOD}", "self.requires_grad_(False)"), id="frozen"),
        pytest.param(
            Reason.no_gradient,
            candidate(
                f"return {GOOD}",
                "for p in self.parameters():\n"
                "    p.register_post_accumulate_grad_hook(lambda p: setattr(p, 'grad', None))",
            ),
            id="gradients thrown away",
        ),
        pytest.param(
            Reason.construction_failed,
            candidate(f"return {GOOD}", "self.conv.weight = type('Few', (nn.Parameter,), {})(torch.zeros(4, 3, 3, 3))"),
            id="parameter of its own class",
        ),
        pytest.param(
            Reason.construction_failed,
            VALID.replace("    def __init__", "    def __new__(cls, **_):\n        return 3\n\n    def __init__"),
            id="number instead of a network",
        ),
        pytest.param(
            Reason.no_gradient,
            "class ImageRegressionCNN(nn.Module):\n    def forward(self, x):\n        return x.mean((2, 3))\n",
            id="no parameter",
        ),
        pytest.param(
            Reason.backward_failed,
            candidate(f"h = torch.sigmoid({GOOD})\nout = h * h\nh.mul_(2)\nreturn out"),
            id="saved value changed in place",
        ),
        pytest.param(
            Reason.nondeterministic,
            candidate(f"return {GOOD}", "g = torch.Generator()\ng.seed()\nself.conv.weight.data.normal_(generator=g)"),
            id="weights from fresh entropy",
        ),
        pytest.param(
            Reason.out_of_memory,
            candidate(f"return {GOOD}", "self.huge = nn.utils.skip_init(nn.Linear, 10**7, 10**7)"),
            id="400 terabytes",
        ),
    ],
)
def test_failure_has_its_reason(reason: Reason, source: str) -> None:
    """Each way to fail is told apart, with a line for a person."""
    rejection = rejection_of(source)
    assert rejection.reason is reason
    assert 0 < len(rejection.detail) <= 300
    assert "\n" not in rejection.detail


def test_detail_names_what_was_expected_and_what_came() -> None:
    """A wrong shape is reported with both shapes."""
    rejection = rejection_of(candidate("return self.conv(x).mean((2, 3))"))
    assert rejection.detail == "expected shape (2, 3); got (2, 4)"


@pytest.mark.parametrize(
    "source",
    [
        pytest.param(candidate(f"return {GOOD}.t().contiguous().t()"), id="transposed output"),
        pytest.param(candidate(f"return {GOOD}", "self.unused = nn.Linear(5, 7)"), id="unused layer"),
        pytest.param(
            candidate(f"return {GOOD}", "self.register_buffer('mask', torch.full((3,), -math.inf))"), id="mask"
        ),
        pytest.param(candidate(f"return F.dropout({GOOD}, 0.5, self.training)"), id="dropout"),
        pytest.param(
            candidate(f"self.calls = self.calls + 1\nreturn {GOOD} * self.calls", "self.calls = 0"),
            id="counts its calls",
        ),
        pytest.param(candidate(f"return {GOOD}", "torch.rand(3)"), id="draws from the seeded generator"),
    ],
)
def test_untidy_but_sound_candidate_is_admitted(source: str) -> None:
    """What trains and repeats itself is admitted, however it is written."""
    assert profile_of(source).parameters > 0


@pytest.mark.parametrize(
    ("kernels", "source"),
    [
        (("sqrt",), candidate(f"return ({GOOD}.abs() + 0.1).sqrt()")),
        (("sqrt",), candidate(f"return ({GOOD}.abs() + 0.1) ** 0.5")),
        (("sqrt",), candidate("return self.head(F.lp_pool2d(self.conv(x).abs() + 0.1, 2, 2).mean((2, 3)))")),
        (("sqrt",), candidate(f"return {GOOD} * self.scale", "self.scale = torch.sqrt(torch.tensor(2.0))")),
        (("atan",), candidate(f"y = {GOOD}\nreturn getattr(torch, 'arct' + 'an')(y) if self.training else y")),
        (("acos",), candidate(f"return torch.acos(torch.tanh({GOOD}))")),
        (("asin",), candidate(f"return torch.asin(torch.tanh({GOOD}))")),
        (("mkldnn_rnn_layer",), candidate(f"return {GOOD} + self.r(x[:, :, 0])[0].mean()", "self.r = nn.LSTM(32, 3)")),
        ((), candidate(f"return ({GOOD} ** 2 + 0.1).rsqrt() * math.sqrt(2) + x.std((1, 2, 3))[:, None]")),
    ],
)
def test_operations_that_are_not_portable_are_named(kernels: tuple[str, ...], source: str) -> None:
    """However they are called, while building too and in either mode; equal portable forms are not."""
    assert profile_of(source).not_portable == kernels


def test_probe_repeats_itself() -> None:
    """Equal sources have equal profiles, whatever was drawn before."""
    first = profile_of(VALID)
    torch.rand(7)
    assert profile_of(VALID) == first
