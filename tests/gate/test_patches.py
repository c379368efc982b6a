"""Promise: edits are applied exactly or the answer is rejected; what comes of them goes through the whole gate."""

import pytest

from tacevo.gate.extraction import edited, extract
from tacevo.gate.policy.check import rejection_of
from tacevo.records import Completion, Contract, Kind, Loss, Reason, Rejection

CONTRACT = Contract(
    class_name="Net", kind=Kind.regression, loss=Loss.mse, in_channels=3, image_size=32, outputs=3, output_argument="n"
)

PARENT = """\
class Part(nn.Module):
    def forward(self, x):
        return x


class Net(nn.Module):
    def __init__(self, in_channels=3, n=3):
        super().__init__()
        self.conv1 = nn.Conv2d(in_channels, 8, 3)
        self.conv2 = nn.Conv2d(8, 8, 3)
        self.head = nn.Linear(8, n)

    def forward(self, x):
        x = self.conv1(x)
        x = self.conv2(x)
        return self.head(x.mean((2, 3)))"""

CONV2 = "        self.conv2 = nn.Conv2d(8, 8, 3)"


def edit(searched: str, replaced: str) -> str:
    """Write one edit."""
    return f"<<<<<<< SEARCH\n{searched}\n=======\n{replaced}\n>>>>>>> REPLACE\n"


def result(text: str, stop_reason: str = "end_turn", parent: str = PARENT) -> str | Reason:
    """Return the source that an answer gives, or the reason for which it is rejected."""
    completion = Completion(text=text, model="m", stop_reason=stop_reason, input_tokens=1, output_tokens=1)
    whole = edited(completion, parent, "Net")
    source = whole if isinstance(whole, Rejection) else extract(whole, CONTRACT, f"Parent network:\n\n{parent}")
    found = source if isinstance(source, Rejection) else rejection_of(source, CONTRACT) or source
    return found.reason if isinstance(found, Rejection) else found


WIDER = PARENT.replace("8, 8, 3", "8, 16, 3") + "\n"


@pytest.mark.parametrize(
    "text",
    [
        edit(CONV2, CONV2.replace("8, 8", "8, 16")),
        f"I widen it.\n\n```python\n{edit(CONV2, CONV2.replace('8, 8', '8, 16'))}```\nDone.",
        f"```\n{edit(CONV2, CONV2.replace('8, 8', '8, 16'))}```".replace("\n", "\r\n"),
        f"<think>{edit(CONV2, 'x')}</think>\n{edit(CONV2, CONV2.replace('8, 8', '8, 16'))}",
    ],
)
def test_edit_is_applied_exactly(text: str) -> None:
    """Words, fences and thoughts around it do not count, nor how lines end."""
    assert result(text) == WIDER


def test_edits_refer_to_the_parent_as_it_was_sent() -> None:
    """So their order does not matter, and one may write what another one searches for."""
    one = edit("        x = self.conv2(x)", "        x = self.conv1(x)")
    other = edit("        x = self.conv1(x)", "        x = self.conv2(x)")
    swapped = PARENT.replace("x = self.conv1(x)", "A").replace("x = self.conv2(x)", "x = self.conv1(x)")
    expected = swapped.replace("A", "x = self.conv2(x)") + "\n"
    assert result(one + other) == result(other + one) == expected


def test_empty_replacement_deletes() -> None:
    """The lines that stand there go, and nothing else."""
    text = "<<<<<<< SEARCH\n        x = self.conv2(x)\n=======\n>>>>>>> REPLACE\n"
    assert result(text) == PARENT.replace("        x = self.conv2(x)\n", "") + "\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (edit("    def forward(self, x):", "    def forward(self, y):"), Reason.misfit_edit),  # stands there twice
        (edit("        self.conv9 = nn.Conv2d(8, 8, 3)", CONV2), Reason.misfit_edit),  # nowhere
        (edit(CONV2.strip(), CONV2), Reason.misfit_edit),  # without its indentation
        (edit("nn.Conv2d(8, 8, 3)", "nn.Conv2d(8, 9, 3)"), Reason.misfit_edit),  # a part of a line
        (edit("Parent network:", "x"), Reason.misfit_edit),  # of the request, and not of the parent
        (edit("", "import os"), Reason.misfit_edit),
        (edit(CONV2, "a") + edit(CONV2, "b"), Reason.misfit_edit),
        (edit(CONV2, CONV2).replace(">>>>>>> REPLACE", ""), Reason.misfit_edit),
        (edit(CONV2, CONV2).replace("=======\n", ""), Reason.misfit_edit),
        (edit(CONV2, CONV2).replace("<<<<<<< SEARCH", "<<<<<< SEARCH"), Reason.misfit_edit),
        (edit(CONV2, CONV2) + f"```python\n{PARENT}\n```", Reason.ambiguous),
        # Beside the class: what any answer may have there, and no more.
        (edit("class Part(nn.Module):", "import os\n\n\nclass Part(nn.Module):"), Reason.forbidden_import),
        (edit("class Net(nn.Module):", "class Other(nn.Module):"), Reason.no_class),
        (edit("class Part(nn.Module):", "class Net(nn.Module):"), Reason.ambiguous),
        (edit(CONV2, "        self.conv2 = eval('nn')"), Reason.forbidden_name),
        # The rest of the class would be read alone, if the text were not taken as a whole.
        (edit("        return x", "        return x ="), Reason.syntax),
    ],
)
def test_edit_that_does_not_fit_is_rejected(text: str, reason: Reason) -> None:
    """By the gate's reason; nothing is guessed, and nothing is applied in part."""
    assert result(text) is reason


def test_edit_of_a_helper_class_is_an_edit_as_any_other() -> None:
    """What stands beside the class is a part of the network, too."""
    assert (
        result(edit("        return x", "        return 2 * x"))
        == PARENT.replace("return x\n", "return 2 * x\n") + "\n"
    )


@pytest.mark.parametrize("stop_reason", ["max_tokens", "model_context_window_exceeded"])
def test_answer_that_was_cut_off_is_no_edit(stop_reason: str) -> None:
    """Even behind a whole edit: another one may be missing."""
    whole = edit(CONV2, CONV2.replace("8, 8", "8, 16"))
    assert result(whole, stop_reason) is Reason.truncated
    assert result(whole[:-4], stop_reason) is Reason.truncated
    assert result(whole, "unknown") == WIDER
    assert result(whole[:-4], "unknown") is Reason.truncated


def test_whole_class_may_stand_in_place_of_edits() -> None:
    """An answer without a mark is read as ever."""
    assert result(f"```python\n{WIDER}```") == WIDER


def test_fences_in_the_network_do_not_end_it() -> None:
    """The text after the edits is taken whole, whatever it holds."""
    fenced = PARENT.replace("class Net(nn.Module):\n", 'class Net(nn.Module):\n    """\n~~~\n```\n~~~~~~\n    """\n\n')
    assert result(edit(CONV2, CONV2.replace("8, 8", "8, 16")), parent=fenced) == fenced.replace("8, 8", "8, 16") + "\n"
