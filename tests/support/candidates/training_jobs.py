"""A tiny learnable task for the tests of training: 3 x 4 x 4 images whose first two pixels are the targets."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from tacevo.records import Contract, Kind, Limits, Loss, Recipe, to_json
from tacevo.sandbox.child import Arrays, Send
from tacevo.sandbox.client import Finished, Score
from tacevo.training.evaluation import Examples
from tacevo.training.trainer import run

#: Not that of fakes.py, whose import starts a thread, which a zygote must not have.
_IMAGES: Any = {"in_channels": 3, "image_size": 4, "outputs": 2, "output_argument": "num_outputs"}
CONTRACT = Contract(class_name="Net", kind=Kind.regression, loss=Loss.mse, **_IMAGES)
RECIPE = Recipe(
    epochs=4, batch_size=16, learning_rate=1e-2, optimiser="adam", limits=Limits(seconds=20, memory_mib=400)
)
SOURCE = """
class Net(nn.Module):
    def __init__(self, in_channels=3, num_outputs=2):
        super().__init__()
        self.body = nn.Sequential(nn.Flatten(), nn.Linear(in_channels * 16, 32), nn.ReLU(), nn.Dropout(0.1))
        self.head = nn.Linear(32, num_outputs)

    def forward(self, x):
        return self.head(self.body(x))
"""


@dataclass(frozen=True, eq=False)
class Data:
    """Images and labels of a task: 128 for training, 8 for validation."""

    images: NDArray[np.uint8]
    train: NDArray[np.int64]
    validation: NDArray[np.int64]
    #: For all images; float32 (136, 2), or int64 (136,).
    targets: NDArray[Any]


def examples(*, classes: bool = False) -> Data:
    """Make the task, always the same."""
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (136, 3, 4, 4), dtype=np.uint8)
    pixels = images[:, 0, 0, :2].astype(np.float32) / 255
    targets = (pixels[:, 0] > pixels[:, 1]).astype(np.int64) if classes else pixels
    rows = rng.permutation(136)
    return Data(images, rows[:128], rows[128:], targets)


def labelled(data: Data) -> Examples:
    """Return the rows and labels of the task as an evaluator takes them."""
    return Examples(
        train=data.train,
        validation=data.validation,
        train_targets=data.targets[data.train],
        validation_targets=data.targets[data.validation],
        mean=(127.5,) * 3,
        deviation=(74.0,) * 3,
        fingerprint="abc",
    )


def header_of(source: str, data: Data) -> Any:
    """Write the header that a trainer gets."""
    return {
        "source": source,
        "contract": to_json(CONTRACT),
        "recipe": to_json(RECIPE),
        "seed": 0,
        "mean": [127.5] * 3,
        "deviation": [74.0] * 3,
        "train": len(data.train),
        "validation": len(data.validation),
    }


def payload_of(data: Data) -> bytes:
    """Write the payload that a trainer gets."""
    return data.train.tobytes() + data.validation.tobytes() + data.targets[data.train].tobytes()


def trained(header: Any, data: Data, images: Any = None) -> list[tuple[Any, bytes]]:
    """Train in this process; return the frames that are sent. The images are those of the data where none are given."""
    frames: list[tuple[Any, bytes]] = []
    arrays = {"images": data.images if images is None else images}
    run(header, payload_of(data), arrays, lambda head, payload: frames.append((head, payload)))
    return frames


class Recorder:
    """A sandbox that notes what it is sent, and always answers alike."""

    def __init__(self, answer: Finished) -> None:
        self.sent: list[tuple[Any, bytes]] = []
        #: Of each job that is scored, its scores.
        self.scores: list[list[float]] = []
        self._answer = answer

    def run(self, entry: str, header: Any, payload: bytes, limits: Limits, score: Score | None = None) -> Finished:
        """Answer as a trainer would."""
        self.sent.append((header, payload))
        if score is not None:
            self.scores.append([score(at, frame.payload) for at, frame in enumerate(self._answer.frames)])
        return self._answer


def look_at_torch(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Report how torch computes in a candidate's process, and where three classes lie (a set iterates in that order).

    An entry of a sandbox.
    """
    kinds = (torch.nn.ReLU, torch.nn.Conv2d, np.ndarray)
    capability, threads = torch.backends.cpu.get_cpu_capability(), torch.get_num_threads()
    send({"capability": capability, "threads": threads, "addresses": [id(kind) for kind in kinds]}, b"")
