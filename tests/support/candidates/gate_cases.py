"""What the gate's tests share: contracts, completions, a small valid candidate and the real-text examples."""

import json
from typing import Any

import pytest
from checkout import SHARED, VARIABLE

from tacevo.gate.extraction import extract, first_look
from tacevo.records import Completion, Contract, Kind, Loss, Rejection, Stage

#: A candidate that passes the gate at any image size.
VALID = '''class ImageRegressionCNN(nn.Module):
    """Tiny but trainable."""

    def __init__(self, in_channels=3, num_outputs=3):
        super().__init__()
        self.conv = nn.Conv2d(in_channels, 4, 3)
        self.head = nn.Linear(4, num_outputs)

    def forward(self, x):
        return self.head(F.relu(self.conv(x)).mean((2, 3)))
'''


def contract(task: str = "force", image_size: int = 32) -> Contract:
    """Make the contract of a task whose baseline the examples were asked to change."""
    if task == "force":
        return Contract(
            class_name="ImageRegressionCNN",
            kind=Kind.regression,
            loss=Loss.mse,
            in_channels=3,
            image_size=image_size,
            outputs=3,
            output_argument="num_outputs",
        )
    return Contract(
        class_name="SingleLabelClassCNN",
        kind=Kind.classification,
        loss=Loss.cross_entropy,
        in_channels=3,
        image_size=image_size,
        outputs=7,
        output_argument="num_classes",
    )


def completion(text: str, stop_reason: str = "end_turn") -> Completion:
    """Wrap text as a model's answer."""
    return Completion(text=text, model="test", stop_reason=stop_reason, input_tokens=0, output_tokens=0)


def extracted(answer: Completion, task: Contract) -> str | Rejection:
    """Extract the source of an answer as the gate does."""
    return first_look(answer, limit=100_000) or extract(answer, task)


def source_of(text: str, stop_reason: str = "end_turn") -> str:
    """Extract from an answer to the force task and insist on a source."""
    source = extracted(completion(text, stop_reason), contract())
    assert isinstance(source, str), source
    return source


def refusal_of(text: str, stop_reason: str = "end_turn") -> Rejection:
    """Extract from an answer to the force task and insist on a rejection at this stage."""
    refusal = extracted(completion(text, stop_reason), contract())
    assert isinstance(refusal, Rejection), refusal
    assert refusal.stage is Stage.extract
    return refusal


def fenced(code: str, language: str = "python") -> str:
    """Put code between fences."""
    return f"```{language}\n{code}```"


def candidate(forward: str, init: str = "") -> str:
    """Make a candidate with its own lines in the constructor and in the forward pass."""
    body = [f"        {line}" for line in init.split("\n") if init]
    steps = [f"        {line}" for line in forward.split("\n")]
    start = VALID.split("    def forward", maxsplit=1)[0].rstrip("\n")
    return "\n".join([start, *body, "", "    def forward(self, x):", *steps, ""])


def examples(folder: str) -> list[Any]:
    """Read every example of a shared directory, each with its file's name under `file`."""
    files = sorted((SHARED / folder).glob("*.json"))
    return [{**json.loads(path.read_text(encoding="utf-8")), "file": path.stem} for path in files]


needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason=f"{VARIABLE} names no directory of real answers")
