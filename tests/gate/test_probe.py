"""The probe admits what trains and measures it; everything else gets the reason that fits.

These tests run `run` in this process, on harmless candidates only; test_admission.py goes through the sandbox.
"""

import numpy as np
import pytest
import torch
from checkout import SHARED
from gate_cases import VALID, candidate, contract, needs_shared
from numpy.typing import NDArray

from tacevo.evolution.descriptors import describe
from tacevo.gate.probe import run
from tacevo.profile import Profile
from tacevo.records import Contract, Json, Reason, Rejection, Stage, to_json
from tacevo.storage.verdicts import read_verdict

pytestmark = pytest.mark.usefixtures("torch_settings")

LIMITS = {"parameters": 10_000_000, "flops": 10**10, "modules": 100}


def probe(source: str, task: Contract, shown: NDArray[np.uint8] | None = None, **limits: int) -> Profile | Rejection:
    """Run the probe, on images of a data set as well where some are given, and read its one frame."""
    frames: list[Json] = []
    header: dict[str, Json] = {"source": source, "contract": to_json(task), "limits": {**LIMITS, **limits}}
    payload, arrays = b"", dict[str, NDArray[np.uint8]]()
    if shown is not None:
        header |= {"mean": [127.0] * 3, "deviation": [60.0] * 3}
        payload, arrays = np.arange(16).tobytes(), {"images": shown}
    run(header, payload, arrays, lambda frame, _: frames.append(frame))
    (answer,) = frames
    return read_verdict(Profile, "profile", answer, place="answer")


def profile_of(source: str, task: Contract | None = None, **limits: int) -> Profile:
    """Probe and insist on a profile."""
    verdict = probe(source, task or contract(), None, **limits)
    assert isinstance(verdict, Profile), verdict
    return verdict


def rejection_of(source: str, **limits: int) -> Rejection:
    """Probe and insist on a rejection at this stage."""
    verdict = probe(source, contract(), None, **limits)
    assert isinstance(verdict, Rejection)
    assert verdict.stage is Stage.probe
    return verdict


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
    descriptor = describe(profile)
    assert descriptor.entropy == pytest.approx(0.934978, abs=1e-6)
    assert descriptor.density == 0.2
    assert descriptor.variation == pytest.approx(0.178174, abs=1e-6)
    assert descriptor.arch_div == pytest.approx(0.437717, abs=1e-6)
    assert descriptor.eff_ratio == pytest.approx(0.722902, abs=1e-6)


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
                "def drop(p):\n    p.grad = None\n"
                "for p in self.parameters():\n    p.register_post_accumulate_grad_hook(drop)",
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
            candidate(f"self.calls = self.calls + self.training\nreturn {GOOD} * self.calls", "self.calls = 0"),
            id="counts its calls in training",
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
        (
            ("linalg_cholesky_ex",),
            candidate(f"return {GOOD} * self.scale", "self.scale = torch.linalg.cholesky(torch.eye(2))[0, 0]"),
        ),
        (
            ("linalg_cholesky_ex",),
            candidate(
                f"with torch.inference_mode():\n    getattr(torch.linalg, 'chol' + 'esky')(torch.eye(2))\nreturn {GOOD}"
            ),
        ),
        (
            ("linalg_cholesky_ex",),
            candidate(f"y = {GOOD}\nreturn y * torch.linalg.cholesky(torch.eye(2))[0, 0] if self.training else y"),
        ),
        (
            ("mkldnn_rnn_layer",),
            candidate(f"return {GOOD} + self.r(x[:, :, 0])[0].mean(1)", "self.r = nn.LSTM(32, 3, batch_first=True)"),
        ),
        ((), candidate(f"return ({GOOD} ** 2 + 0.1).rsqrt() * math.sqrt(2) + x.std((1, 2, 3))[:, None]")),
        ((), candidate(f"return ({GOOD}.abs() + 0.1) ** 0.5 + torch.atan(torch.acos(torch.tanh({GOOD})).sqrt())")),
        ((), candidate("return self.head(F.lp_pool2d(self.conv(x).abs() + 0.1, 2, 2).mean((2, 3)))")),
    ],
)
def test_operations_that_are_not_portable_are_named(kernels: tuple[str, ...], source: str) -> None:
    """However they are called, while building too and in either mode; what is computed alike everywhere is not."""
    assert profile_of(source).not_portable == kernels


def test_probe_repeats_itself() -> None:
    """Equal sources have equal profiles, whatever was drawn before."""
    first = profile_of(VALID)
    torch.rand(7)
    assert profile_of(VALID) == first


#: Each predicts an image otherwise beside other images, or after them.
MIXING = {
    "norm without running statistics": (
        "self.n(self.conv(x))",
        "self.n = nn.BatchNorm2d(4, track_running_stats=False)",
    ),
    "norm in training mode": ("F.batch_norm(self.conv(x), None, None, training=True)", ""),
    "mean of the batch": ("self.conv(x) - self.conv(x).mean(0)", ""),
    "softmax over the batch": ("self.conv(x).softmax(0)", ""),
    "sums along the batch": ("self.conv(x).cumsum(0)", ""),
    "sums against the batch": ("self.conv(x).flip(0).cumsum(0).flip(0)", ""),
    "largest of the batch": ("self.conv(x) / self.conv(x).abs().max()", ""),
    "reshape": ("self.conv(x).transpose(0, 1).reshape(len(x), 4, 30, 30)", ""),
    "neighbour": ("self.conv(x.roll(1, 0))", ""),
    "shuffled": ("self.conv(x)[torch.randperm(len(x))]", ""),
    "ranks": ("self.conv(x) * self.conv(x).mean((1, 2, 3), keepdim=True).argsort(0).argsort(0)", ""),
    "similar images": ("self.conv(x) * torch.einsum('nchw,mchw->n', x, x)[:, None, None, None]", ""),
    "the last one only": ("torch.cat([self.conv(x)[:-1], self.conv(x)[-1:] + self.conv(x)[:1]])", ""),
    "weakly": ("self.conv(x) + self.w * self.conv(x).mean(0)", "self.w = nn.Parameter(torch.zeros(1))"),
    "buffer that adapts": ("self.conv(x) + self.s.add_(x.mean())", "self.register_buffer('s', torch.zeros(1))"),
    "number of calls": ("[self.s.append(1), self.conv(x) * len(self.s)][1]", "self.s = []"),
}


def features(expression: str, init: str = "") -> str:
    """Make a candidate of an expression of its feature maps."""
    return candidate(f"return self.head(({expression}).mean((2, 3)))", init)


@pytest.mark.parametrize(("expression", "init"), MIXING.values(), ids=MIXING.keys())
def test_prediction_depends_on_its_own_image_only(expression: str, init: str) -> None:
    """Such a network could use the test images of others, and its score depends on the size of a batch."""
    assert rejection_of(features(expression, init)).reason is Reason.depends_on_batch


def smooth_images() -> NDArray[np.uint8]:
    """Draw 16 images of slow waves, shape (16, 3, 32, 32), as a soft skin shows them; noise has no such neighbours."""
    across, down = np.meshgrid(np.arange(32), np.arange(32))
    waves = [[np.sin((i % 5 + 1) * across / 16 + i * down / 32 + channel) for channel in range(3)] for i in range(16)]
    return (127 + 100 * np.array(waves)).astype(np.uint8)


#: Whether an image is smooth: its neighbours differ little.
SMOOTH = "(x[..., 1:] - x[..., :-1]).abs().mean() < 0.5"


@pytest.mark.parametrize(
    "forward",
    [
        f"y = self.conv(x)\nif {SMOOTH}:\n    y = y + self.wide(x).mean(1, keepdim=True)\n{{}}",
        f"y = self.conv(x if {SMOOTH} else x[..., ::2, ::2])\n{{}}",
        f"y = self.conv(x)\nif {SMOOTH}:\n    y = y - y.mean(0)\n{{}}",
        f"smooth = {SMOOTH}\ny = self.conv(x)\ny = y - smooth * y.mean(0)\n{{}}",
        "y = self.conv(x)\nif not x.is_contiguous():\n    y = y + self.wide(x).mean(1, keepdim=True)\n{}",
        f"y = self.conv(x)\nif self.training and {SMOOTH}:\n    self.kept.add_(y.detach().mean())\n{{}}",
    ],
    ids=["wider", "finer", "mixes by a branch", "mixes by a factor", "layout", "learns"],
)
def test_content_of_an_image_does_not_tell_the_probe_from_the_training(forward: str) -> None:
    """Images of the data set run through what noise runs through, alone and beside others; what learns there counts."""
    init = "self.wide = nn.Conv2d(in_channels, 64, 3)\nself.register_buffer('kept', torch.zeros(1))"
    source = candidate(forward.format("return self.head(F.relu(y).mean((2, 3)))"), init)
    assert isinstance(probe(source, contract()), Profile)
    verdict = probe(source, contract(), smooth_images())
    if isinstance(verdict, Profile):
        assert verdict.learnt_outside == 1
    else:
        assert verdict.reason is Reason.depends_on_batch


@pytest.mark.parametrize(
    ("features", "init"),
    [
        ("torch.cdist(y, self.centres)", "self.centres = nn.Parameter(torch.randn(4, 4))"),
        ("F.elu(F.celu(y))", ""),
        ("F.relu(F.threshold(y, 0.1, 0.2))", ""),
        ("F.mse_loss(y, self.centre.expand_as(y), reduction='none')", "self.centre = nn.Parameter(torch.zeros(4))"),
        ("y @ self.twin", "self.own = nn.Linear(4, 4)\nself.twin = nn.Parameter(self.own.weight.data.t())"),
    ],
    ids=["distances", "two units", "threshold", "loss within", "weights that share memory"],
)
def test_honest_backward_pass_is_one(features: str, init: str) -> None:
    """A node may run its kernel for each input that learns, or that of another name; weights may share memory."""
    source = candidate(f"y = self.conv(x).mean((2, 3))\nreturn self.head({features})", init)
    verdict = probe(source, contract(), smooth_images())
    assert isinstance(verdict, Profile), verdict


def test_network_that_takes_a_layout_in_evaluation_only_is_admitted() -> None:
    """Its training uses the other one."""
    flat = "x = x.view(-1).view(x.shape) if self.training else x\n"
    source = candidate(f"{flat}return self.head(F.relu(self.conv(x)).mean((2, 3)))")
    assert isinstance(probe(source, contract(), smooth_images()), Profile)


def test_images_of_the_data_change_no_honest_profile() -> None:
    """A network has one profile, whichever data set it is probed for."""
    flat = candidate("return self.flat(x.view(len(x), -1))", "self.flat = nn.Linear(3 * 32 * 32, 3)")  # one layout only
    for source in (VALID, features("self.n(self.conv(x))", "self.n = nn.BatchNorm2d(4)"), flat):
        assert probe(source, contract(), smooth_images()) == profile_of(source)


#: A number of 0 to 1020 that the address of a new object gives. Two addresses give one number once in 1021 times; a
#: number of few values, which the probe misses more often, would make a test fail by chance.
ADDRESS = "int(str(object())[-13:-1], 16) // 16 % 1021"


@pytest.mark.parametrize(
    "source",
    [
        candidate("return self.head(F.relu(self.conv(x)).mean((2, 3)))", f"self.odd = nn.Linear({ADDRESS} + 1, 1)"),
        features(f"self.conv(x) * ({ADDRESS} + 1)"),
        features("self.conv(x) + hash(object()) % 1021"),
        features("self.conv(x) * self.scale", "self.scale = hash(self) % (2**24 - 3) + 1"),
    ],
    ids=["width", "output", "hash", "hash of the network"],
)
def test_network_does_not_depend_on_addresses(source: str) -> None:
    """They are equal in every process of one machine, so the probe moves its memory between two looks."""
    assert rejection_of(source).reason in {Reason.nondeterministic, Reason.depends_on_batch}


@pytest.mark.parametrize(
    "expression",
    [
        "self.conv(x) + 0.1 * torch.randn_like(self.conv(x))",
        "F.dropout(self.conv(x), 0.5)",
        "[nn.Dropout(0.5)][0](self.conv(x))",
        "self.conv(x) * (torch.rand(1) > 0.5)",
        "torch.bernoulli(self.conv(x).sigmoid())",
        "self.conv(x)[:, torch.randperm(4)]",
        "self.conv(x) + torch.randn(self.conv(x).shape, generator=torch.Generator())",
        "self.conv(x) + torch.randn(self.conv(x).shape, generator=torch.Generator().manual_seed(3))",
    ],
)
def test_evaluation_leaves_nothing_to_chance(expression: str) -> None:
    """A prediction that is drawn cannot be repeated from the weights."""
    assert rejection_of(features(expression)).reason is Reason.random_in_evaluation


@pytest.mark.parametrize(
    ("expression", "init"),
    [
        ("self.n(self.conv(x))", "self.n = nn.BatchNorm2d(4)"),
        ("F.instance_norm(self.conv(x))", ""),
        ("self.n(self.conv(x))", "self.n = nn.GroupNorm(2, 4)"),
        ("self.conv(x) * (1 if not self.training else 1 + torch.rand(1))", ""),
        ("F.gumbel_softmax(self.conv(x), dim=1) if self.training else self.conv(x).softmax(1)", ""),
        ("self.conv(x) + 0 * torch.rand(1)", ""),
    ],
)
def test_chance_and_statistics_in_training_are_honest(expression: str, init: str) -> None:
    """What training draws or averages, and what is drawn without effect, changes no prediction."""
    assert profile_of(features(expression, init)).parameters >= 127


def test_output_that_is_written_to_again_is_compared_as_it_was() -> None:
    """One memory for all outputs would make equal what was not."""
    source = candidate(
        f"y = {GOOD} - ({GOOD}).mean(0)\nself.kept[: len(x)] = y.detach()\n"
        "return y if self.training else self.kept[: len(x)]",
        "self.kept = torch.zeros(64, 3)",
    )
    assert rejection_of(source).reason is Reason.depends_on_batch


@pytest.mark.parametrize(
    "init",
    [
        "self.conv.weight.data.normal_(generator=torch.Generator().manual_seed(3))",
        "self.conv.weight.data.normal_(generator=torch.Generator())",
        "g = torch.Generator()\ng.set_state(torch.Generator().manual_seed(4).get_state())\n"
        "self.w = nn.Parameter(torch.rand(5, generator=g))",
        "torch.manual_seed(7)\nself.extra = nn.Linear(3, 3)",
        "self.order = torch.randperm(64, generator=torch.Generator().manual_seed(5))",
    ],
)
def test_initial_weights_follow_the_seed(init: str) -> None:
    """A lucky draw that is written down is not an architecture."""
    assert rejection_of(candidate(f"return {GOOD}", init)).reason is Reason.fixed_seed


@pytest.mark.parametrize(
    "init",
    [
        "nn.init.zeros_(self.head.weight)\nnn.init.eye_(self.head.weight)",
        "self.w = nn.Parameter(torch.linspace(0, 1, 99).sin())",
        "nn.init.uniform_(self.head.bias, 0.5, 0.5)\nnn.init.normal_(self.head.bias, 0, 0)",
        "self.pick = torch.randint(0, 2, (1,))\nself.drop = torch.bernoulli(torch.zeros(99))",
        "nn.init.orthogonal_(self.head.weight)\nnn.init.trunc_normal_(self.head.weight)",
    ],
)
def test_constant_weights_are_honest(init: str) -> None:
    """Filters and encodings that are written out are, too, and so is a draw that chance may repeat."""
    assert profile_of(candidate(f"return {GOOD}", init)).learnt_outside == 0


@pytest.mark.parametrize("forward", ["x -= 0.5", "x.neg_()", "x.normal_() if self.training else x.mul_(2)"])
def test_network_may_write_to_its_input(forward: str) -> None:
    """The trainer makes a batch anew, so nothing else sees it."""
    assert profile_of(candidate(f"{forward}\nreturn {GOOD}")).flops == profile_of(VALID).flops


#: Says that it is a function, and that it holds nothing.
MASKED = """class Mask:
    __class__ = property(lambda self: type(lambda: 0))
    __closure__ = __defaults__ = __kwdefaults__ = None
    __dict__ = property(lambda self: {})
self.mask = Mask()
self.mask.s = torch.zeros(6)"""


@pytest.mark.parametrize(
    ("init", "forward", "learnt"),
    [
        ("self.register_buffer('w', torch.zeros(3))", "self.w.add_(y.detach().mean(0))", 3),
        ("self.w = torch.zeros(7)", "self.w = self.w + 1", 7),
        ("self.w = [torch.zeros(2), {'a': torch.zeros(5)}]", "self.w[1]['a'] += 1", 5),
        ("w = torch.zeros(4)\nself.learn = lambda: w.add_(1)", "self.learn()", 4),
        ("self.register_buffer('steps', torch.zeros(()))", "self.steps += 1", 1),
        ("self.m = nn.BatchNorm1d(9, affine=False)", "self.m.running_var.add_(y.detach().mean())", 9),
        ("self.m = nn.BatchNorm1d(9)", "self.m.running_mean = self.m.running_mean + 1", 9),
        ("def hold(): pass\nhold.s = torch.zeros(6)\nself.hold = hold", "self.hold.s = self.hold.s + 1", 6),
        (MASKED, "self.mask.s += 1", 6),
        ("self.grid = None", "self.grid = torch.linspace(-1, 1, 8)", 0),
        ("self.grid = [torch.ones(8), torch.zeros(8)]", "self.grid = [torch.zeros(8), torch.ones(8)]", 0),
        ("self.grid = [torch.ones(8), torch.zeros(8)]", "self.grid = [torch.zeros(8), self.grid[0] + 1]", 8),
        ("self.norm = nn.BatchNorm2d(4)", "self.norm(self.conv(x))", 0),
        ("self.norm = nn.utils.parametrizations.spectral_norm(nn.Linear(3, 3))", "y = self.norm(y)", 0),
        ("self.norm = nn.utils.parametrizations.weight_norm(nn.Linear(3, 3))", "y = self.norm(y)", 0),
        ("self.seen = None", "self.seen = y.detach()", 0),
        ("self.mask = torch.ones(9)", "self.mask.sum()", 0),
    ],
)
def test_what_is_learnt_outside_the_parameters_is_counted(init: str, forward: str, learnt: int) -> None:
    """In buffers, attributes, lists and closures. What layers that run keep, and what is made again, is not learnt."""
    steps = "\n".join(f"    {line}" for line in forward.split("\n"))
    source = candidate(f"y = {GOOD}\nif self.training:\n{steps}\nreturn y", init)
    profile = profile_of(source)
    assert profile.learnt_outside == learnt
    assert profile.learnt == profile.parameters + learnt


def test_global_that_learns_is_counted_and_limited() -> None:
    """A tensor beside the class is as good as a weight; the limit on parameters covers it, and the descriptor too."""
    source = "TABLE = torch.zeros(1000)\n\n\n" + candidate(
        f"y = {GOOD}\nif self.training:\n    TABLE.add_(y.detach().mean())\nreturn y + TABLE.mean()"
    )
    profile = profile_of(source)
    assert profile.learnt_outside == 1000
    assert rejection_of(source, parameters=1126).reason is Reason.too_many_parameters
    assert describe(profile).eff_ratio == pytest.approx(describe(profile_of(VALID)).eff_ratio * 127 / 1127)


def test_path_that_runs_in_training_only_is_charged() -> None:
    """By hand: beside the usual work, 2 x 4 x 4 x 9 x 30 x 30 FLOPs of a convolution that evaluation leaves out."""
    source = candidate(
        "y = self.conv(x)\nif self.training:\n    y = y + self.more(y)\nreturn self.head(F.relu(y).mean((2, 3)))",
        "self.more = nn.Conv2d(4, 4, 3, padding=1)",
    )
    profile, usual = profile_of(source), profile_of(VALID)
    assert profile.flops == usual.flops
    assert profile.training_flops == usual.flops + 2 * 4 * 4 * 9 * 30 * 30
    assert rejection_of(source, flops=profile.training_flops - 1).reason is Reason.too_many_flops
    assert usual.extra_flops == 0


@pytest.mark.parametrize(("layer", "gates"), [("LSTM", 4), ("GRU", 3)])
@pytest.mark.parametrize("sides", [1, 2])
def test_recurrent_layers_are_counted_by_one_formula(layer: str, gates: int, sides: int) -> None:
    """By hand, for 30 steps of 120 features and 5 units a side: each gate's two products, at every step."""
    init = f"self.r = nn.{layer}(120, 5, batch_first=True, bidirectional={sides == 2})"
    source = candidate(
        f"t = self.conv(x).permute(0, 2, 1, 3).flatten(2)\nreturn {GOOD} + self.r(t)[0].mean((1, 2))[:, None]", init
    )
    recurrent = 2 * 30 * gates * 5 * (120 + 5) * sides
    assert profile_of(source).flops == 2 * profile_of(VALID).flops - 2 * 4 * 3 + recurrent


def test_products_with_vectors_are_counted() -> None:
    """By hand: a matrix of 3 x 3 times a vector, a dot product of 9, and a bilinear form of 3 x 4 x 4."""
    source = candidate(
        "f = F.relu(self.conv(x)).mean((2, 3))\nm = self.w @ self.w[0]\nd = self.w.flatten().dot(self.w.flatten())\n"
        "return self.head(f) + m + d + self.b(f, f)",
        "self.w = nn.Parameter(torch.ones(3, 3))\nself.b = nn.Bilinear(4, 4, 3, bias=False)",
    )
    assert profile_of(source).flops == profile_of(VALID).flops + 2 * 9 + 2 * 9 + 2 * 3 * 4 * 4


@pytest.mark.parametrize(("kind", "hint"), [("int64", "buffer"), ("complex64", "imaginary parts")])
def test_parameter_that_no_gradient_can_change_is_told_what_to_do(kind: str, hint: str) -> None:
    """In our words: torch's optimiser would speak of its own fused form."""
    init = f"self.w = nn.Parameter(torch.ones(3, dtype=torch.{kind}), requires_grad=False)"
    rejection = rejection_of(candidate(f"return {GOOD}", init))
    assert rejection.reason is Reason.construction_failed
    assert kind in rejection.detail
    assert hint in rejection.detail


@pytest.mark.parametrize(
    "source",
    [
        *(
            candidate(f"return {GOOD}", init)
            for init in (
                "getattr(F.relu, '__glo' + 'bals__')",
                "setattr(self, 'fo' + 'rward_hooks'[3:], 1) or setattr(self, '_for' + 'ward_hooks', {})",
                "setattr(nn.Linear, 'x' + 'y', 3)",
                "hasattr(self.conv.weight, '_' + 'grad')",
                "delattr(nn.Conv2d, 'for' + 'ward')",
                "class Name(str):\n    pass\ngetattr(self.conv, Name('weight'))",
            )
        ),
        candidate(f"getattr(self.conv.weight, 'da' + 'ta').neg_()\nreturn {GOOD}"),
        candidate(f"setattr(self, 'train' + 'ing', True)\nreturn {GOOD}"),
        "getattr = None\ndel getattr\n" + candidate(f"getattr(x, 'num' + 'py')()\nreturn {GOOD}"),
    ],
)
def test_computed_name_is_looked_up_in_the_lists(source: str) -> None:
    """What the policy refuses in the text, the functions that take a name refuse when they are called."""
    assert rejection_of(source).reason in {Reason.forbidden_name, Reason.construction_failed}


@pytest.mark.parametrize(
    "init",
    [
        "for i in range(3):\n    setattr(self, f'layer{i}', nn.Linear(3, 3))\n"
        "[getattr(self, f'layer{i}') for i in range(3)]",
        "setattr(self, '_' + 'own', 1)\ngetattr(self, '_' + 'own')\ndelattr(self, '_' + 'own')",
        "[getattr(m, 'bias', None) for m in self.modules() if hasattr(m, 'weight')]",
        "getattr(F, 're' + 'lu')(torch.ones(1))",
        "getattr(self, 'no' + 'ne', 3)",
    ],
)
def test_honest_computed_names_are_found(init: str) -> None:
    """Layers in a numbered row, an attribute of its own, and a default."""
    assert profile_of(candidate(f"return {GOOD}", init)).flops == profile_of(VALID).flops
