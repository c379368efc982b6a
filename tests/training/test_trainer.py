"""Promise: a training follows from its job alone, learns, and names what the candidate did wrong."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from training_jobs import CONTRACT, RECIPE, SOURCE, Data, examples, header_of, trained

from tacevo.records import Kind, Loss, Reason, to_json
from tacevo.sandbox.candidate import blaming, build, fault, standardise
from tacevo.sandbox.guards import CandidateError
from tacevo.training.trainer import batches


@given(count=st.integers(1, 100), size=st.integers(1, 40), epoch=st.integers(0, 3))
def test_batches_are_full_and_disjoint(count: int, size: int, epoch: int) -> None:
    """Every batch has the asked size, no example comes twice, and at most size - 1 are left out."""
    order = batches(count, size, seed=0, epoch=epoch)
    positions = np.concatenate(order)
    assert len(set(positions.tolist())) == len(positions)
    assert {len(batch) for batch in order} == {min(size, count)}
    assert count - len(positions) < size


def test_batches_differ_between_epochs_and_seeds() -> None:
    """The order is drawn again for each epoch, by name; another one would change every result."""
    orders = {tuple(batches(20, 20, seed, epoch)[0].tolist()) for seed in range(2) for epoch in range(2)}
    assert len(orders) == 4
    assert [batch.tolist() for batch in batches(5, 2, seed=0, epoch=0)] == [[4, 0], [2, 3]]


def test_standardise_takes_the_mean_off_and_divides() -> None:
    """Each channel by its own figures, in float32."""
    images = torch.tensor([[[[10]], [[30]]]], dtype=torch.uint8)
    got = standardise(images, torch.tensor([0.0, 10.0])[:, None, None], torch.tensor([10.0, 5.0])[:, None, None])
    assert got.dtype is torch.float32
    assert got.flatten().tolist() == [1.0, 4.0]


def test_build_passes_only_arguments_that_the_constructor_has() -> None:
    """A class without parameters is built without arguments, one with both gets both."""
    full = "class Net(nn.Module):\n  def __init__(self, num_outputs, in_channels, depth=3):\n    super().__init__()\n"
    assert isinstance(build("class Net(nn.Module):\n    pass\n", CONTRACT, 0), torch.nn.Module)
    assert build(f"{full}    self.seen = (num_outputs, in_channels, depth)\n", CONTRACT, 0).seen == (2, 3, 3)


@pytest.mark.parametrize("source", ["", "Net = 3", "class Net:\n    pass\n", "class Other(nn.Module):\n    pass\n"])
def test_build_names_the_missing_class(source: str) -> None:
    """Text without the contract's class is told apart from a class that fails."""
    with pytest.raises(TypeError, match="expected a class Net that extends"):
        build(source, CONTRACT, 0)


class _Sly(torch.Tensor):
    pass


@pytest.mark.parametrize(
    ("output", "problem"),
    [
        (torch.zeros(4, 2), None),
        (torch.zeros(2, 4).T, None),
        (torch.zeros(4, 1), "expected shape (4, 2); got (4, 1)"),
        (torch.zeros(4, 2, dtype=torch.complex64), "expected float32; got torch.complex64"),
        (torch.zeros(4, 2).as_subclass(_Sly), "expected a torch.Tensor; got _Sly"),
        ([torch.zeros(2)] * 4, "expected a torch.Tensor; got list"),
        (torch.nn.Parameter(torch.zeros(4, 2)), "expected a torch.Tensor; got Parameter"),
    ],
)
def test_output_must_be_a_plain_float32_tensor_of_the_shape(output: object, problem: str | None) -> None:
    """Nothing broadcasts, nothing is converted, no subclass answers for itself."""
    assert fault(output, (4, 2)) == problem


@pytest.mark.parametrize(
    ("error", "reason", "detail"),
    [
        (ValueError("bad\nmore"), Reason.forward_failed, "ValueError: bad"),
        (MemoryError(), Reason.out_of_memory, "MemoryError"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory"), Reason.out_of_memory, "RuntimeError: Default"),
        (torch.OutOfMemoryError("CUDA out of memory."), Reason.out_of_memory, "OutOfMemoryError: CUDA out of memory"),
        (RuntimeError("CUDA error: out of memory"), Reason.out_of_memory, "RuntimeError: CUDA error"),
        (RuntimeError("CUDA error: CUBLAS_STATUS_ALLOC_FAILED when"), Reason.out_of_memory, "RuntimeError: CUDA error"),
        (RuntimeError("CUDA error: device-side assert triggered"), Reason.forward_failed, "RuntimeError: CUDA error"),
        (CandidateError(Reason.not_finite, "weights"), Reason.not_finite, "weights"),
    ],
)
def test_whatever_a_candidate_raises_becomes_a_failure(error: Exception, reason: Reason, detail: str) -> None:
    """The block names the reason, except where memory ran out or the failure has a reason already."""
    with pytest.raises(CandidateError, match=detail) as caught, blaming(Reason.forward_failed):
        raise error
    assert caught.value.reason is reason


def sent_by(source: str, data: Data | None = None, **changes: Any) -> list[tuple[Any, bytes]]:
    """Train in this process; return the frames that are sent."""
    data = data or examples()
    return trained({**header_of(source, data), **changes}, data)


def test_frames_are_epochs_and_a_digest() -> None:
    """One frame of predictions for each epoch, then one with the hash of the weights."""
    frames = sent_by(SOURCE)
    assert [sorted(header) for header, _ in frames] == [["epoch", "steps", "train_loss"]] * 4 + [["weights_sha256"]]
    assert [header["steps"] for header, _ in frames[:-1]] == [8, 16, 24, 32]
    assert {len(payload) for _, payload in frames[:-1]} == {8 * 2 * 4}


def test_equal_jobs_give_equal_bits() -> None:
    """Nothing but the job enters a training, whatever was drawn before."""
    first = sent_by(SOURCE)
    torch.rand(7)
    assert sent_by(SOURCE) == first
    assert sent_by(SOURCE, seed=1) != first


def net(construct: str = "pass", forward: str = "return self.head(x.flatten(1))") -> str:
    """Write a small network with one line of its constructor and one of its forward pass changed."""
    return (
        "class Net(nn.Module):\n"
        "    def __init__(self):\n"
        "        super().__init__()\n"
        "        self.head = nn.Linear(48, 2)\n"
        f"        {construct}\n"
        "    def forward(self, x):\n"
        f"        {forward}\n"
    )


@pytest.mark.parametrize(
    ("source", "reason", "detail"),
    [
        ("class Net(nn.Module", Reason.construction_failed, "SyntaxError"),
        (net(construct="1 / 0"), Reason.construction_failed, "ZeroDivisionError: division by zero"),
        (net(construct="del self.head"), Reason.construction_failed, "optimizer got an empty parameter list"),
        (net(construct="torch.empty(10**14)"), Reason.out_of_memory, "can't allocate memory"),
        (net(forward="return self.head(x)"), Reason.forward_failed, "mat1 and mat2 shapes cannot be multiplied"),
        (net(forward="return x"), Reason.bad_output, "expected shape (16, 2); got (16, 3, 4, 4)"),
        (net(forward="return self.head(x.flatten(1)).detach()"), Reason.backward_failed, "does not require grad"),
        (net(forward="return self.head(x.flatten(1)) / 0"), Reason.not_finite, "expected a finite training loss"),
    ],
)
def test_failure_is_named(source: str, reason: Reason, detail: str) -> None:
    """What a candidate does wrong arrives as one typed frame."""
    ((header, payload),) = sent_by(source)
    assert header["rejection"]["reason"] == reason.value
    assert detail in header["rejection"]["detail"]
    assert payload == b""


SILENT = """
    def parameters(self, recurse=True):
        return iter([torch.nn.Parameter(torch.zeros(1))])

    def named_parameters(self, *args, **kwargs):
        return iter([])

    def modules(self):
        return iter([])

    def train(self, mode=True):
        return self

    def eval(self):
        return self

    def to(self, *args, **kwargs):
        return self

    def state_dict(self, *args, **kwargs):
        return {}
"""


def test_candidate_is_not_asked_what_it_is() -> None:
    """What a class says of its parameters, mode and state changes no bit, down to the digest of its weights."""
    source = net(construct="self.drop = nn.Dropout()", forward="return self.head(self.drop(x.flatten(1)))")
    assert sent_by(source + SILENT) == sent_by(source)


@pytest.mark.parametrize(
    "forward",
    [
        "assert self.head.weight.grad is None; return self.head(x.flatten(1))",
        "y = self.head(x.flatten(1)); y.requires_grad and y.sum().backward(retain_graph=True); return y",
        "y = self.head(x.flatten(1)); return y if self.training else y.T.contiguous().T",
    ],
)
def test_forward_changes_nothing_by_gradients_and_layout(forward: str) -> None:
    """A step's gradients are gone before the next pass, those of a pass are dropped, and rows are sent one by one."""
    assert sent_by(net(forward=forward)) == sent_by(net())


@pytest.mark.parametrize("when", ["self.training", "not self.training"])
def test_only_steps_change_parameters(when: str) -> None:
    """A network that waits until the probe is over, and then moves its weights, is found at the next step."""
    forward = (
        f"self.kept[0] += {when}; w = [self.head.weight]; self.kept[0] > 2 and w[0].data.mul_(0.9); "
        "return self.head(x.flatten(1))"
    )
    *_, (header, _) = sent_by(net(construct="self.kept = [0]", forward=forward))
    assert header["rejection"]["reason"] == Reason.changes_its_weights.value


def test_what_learns_in_training_only_is_hidden() -> None:
    """The probe's batches are smaller than the trainer's, so what learns is compared with the list at each step."""
    forward = "y = self.head(x.flatten(1)); return y + self.kept[0](x.flatten(1)) if len(x) > 5 else y"
    ((header, _),) = sent_by(net(construct="self.kept = [nn.Linear(48, 2)]", forward=forward))
    assert header["rejection"]["reason"] == Reason.hidden_parameters.value
    assert "got 2 other tensors" in header["rejection"]["detail"]


def test_patched_loss_changes_no_prediction() -> None:
    """A candidate that replaces the library's losses trains on the true one all the same."""
    patched = "for F.mse_loss in [lambda a, b: (a * 0).sum()]:\n    pass\n" + SOURCE
    original = torch.nn.functional.mse_loss
    try:
        assert sent_by(patched) == sent_by(SOURCE)
    finally:
        torch.nn.functional.mse_loss = original


CONVOLUTION = """
class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.conv = nn.Sequential(nn.Conv2d(3, 8, 3, padding=1), nn.BatchNorm2d(8), nn.ReLU(), nn.Dropout(0.1))
        self.head = nn.Linear(128, 2)
        self.calls = 0

    def forward(self, x):
        self.calls += 1
        y = self.conv(x)
        print(y.is_contiguous())
        return self.head(y.flatten(1)) * (1 + 1 / self.calls if self.training else 1)
"""


@pytest.mark.parametrize(
    "flat",
    [
        pytest.param("y.view(len(y), -1)", id="view"),
        pytest.param("(y.view(len(y), -1) if self.training else y.flatten(1))", id="view in training only"),
        pytest.param("(y.flatten(1) + (0 if y.is_contiguous() else 1))", id="asks for the layout"),
    ],
)
def test_candidate_that_needs_the_default_layout_gets_it(flat: str, capsys: pytest.CaptureFixture[str]) -> None:
    """It trains as if nothing else had been tried: no count, statistic or random number is left of the trial."""
    source = CONVOLUTION.replace("y.flatten(1)", flat)
    frames = sent_by(source)
    assert capsys.readouterr().out.endswith("True\n")
    assert len(frames) == RECIPE.epochs + 1
    assert frames == sent_by(source, contiguous=True)


def test_other_candidates_train_in_channels_last(capsys: pytest.CaptureFixture[str]) -> None:
    """Unless the job asks for the default layout, as that of an older run does.

    The losses are equal but for rounding, without a dropout, whose mask is drawn in the order of memory. A frozen
    parameter makes no difference.
    """
    layouts, losses = [], []
    frozen = CONVOLUTION.replace("self.calls = 0", "self.calls = 0\n        self.head.bias.requires_grad_(False)")
    for older in (False, True):
        frames = sent_by(frozen.replace("nn.Dropout(0.1)", "nn.Identity()"), contiguous=older)
        layouts.append(capsys.readouterr().out.splitlines()[-1])
        losses.append([header["train_loss"] for header, _ in frames[:-1]])
    assert layouts == ["False", "True"]
    assert losses[0] == pytest.approx(losses[1], rel=1e-4)


@pytest.mark.parametrize("root", ["(y * y + 1).sqrt()", "(y * y + 1) ** 0.5", "y.atan()"])
def test_functions_of_an_older_training_are_mkls(root: str) -> None:
    """They have other bits; a network without them has the same, so that records of older rules can be compared."""
    with_root = CONVOLUTION.replace("y.flatten(1)", f"({root}).flatten(1)")
    assert sent_by(CONVOLUTION) == sent_by(CONVOLUTION, mkl_functions=True)
    assert sent_by(with_root) != sent_by(with_root, mkl_functions=True)


def test_classification_trains() -> None:
    """Classes are int64 targets of shape (n,)."""
    contract = replace(CONTRACT, kind=Kind.classification, loss=Loss.cross_entropy)
    frames = sent_by(SOURCE, examples(classes=True), contract=to_json(contract))
    assert len(frames) == RECIPE.epochs + 1


def test_groups_share_no_batch() -> None:
    """A network that normalises by the batch, in eval mode too, predicts one group without any trace of the other."""
    source = SOURCE.replace("nn.ReLU()", "nn.BatchNorm1d(32, track_running_stats=False), nn.ReLU()")
    data = examples()
    images = data.images.copy()
    images[data.validation[5:]] = 255 - images[data.validation[5:]]
    other = replace(data, images=images)

    def predicted(data: Data, **header: Any) -> list[bytes]:
        return [payload[: 5 * 2 * 4] for _, payload in sent_by(source, data, **header)]

    assert predicted(data, groups=[5, 3]) == predicted(other, groups=[5, 3])
    assert predicted(data) != predicted(other)


def test_single_small_batch_is_kept() -> None:
    """Fewer images than a batch make one batch of what there is."""
    assert len(sent_by(SOURCE, recipe=to_json(replace(RECIPE, epochs=1, batch_size=1000)))) == 2
