"""The best bare training loop, in an ordinary process: the peer of a confined one.

Run as a program, it prints a line when it is ready, and trains for every line that it reads, which is a number of
epochs. Images are standardised once and lie in channels_last (weights that lie so, too, gain nothing at these sizes),
Adam is fused, and batches are full; the environment decides threads and instruction sets.
"""

import sys
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

#: Images that are trained on, and further ones that are predicted, of the table's figures.
TRAINED, PREDICTED = 256, 64
BATCH, LEARNING_RATE = 32, 1e-3
MEAN, DEVIATION = 127.5, 74.0


def train(network: type[nn.Module], images: Tensor, targets: Tensor, epochs: int) -> Tensor:
    """Train a new network; return its last predictions.

    Args:
        network: makes itself without arguments.
        images: standardised, float32, shape (n + m, 3, H, W); the last m are predicted after every epoch.
        targets: float32, shape (n, 3).
        epochs: at least 1.
    """
    model = network()
    optimiser = torch.optim.Adam(model.parameters(), LEARNING_RATE, fused=True)
    for _ in range(epochs):
        model.train()
        for rows in torch.split(torch.randperm(len(targets)), BATCH):
            if len(rows) == BATCH:
                loss = mse_loss(model(images[rows]), targets[rows])
                optimiser.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                optimiser.step()
        model.eval()
        with torch.no_grad():
            predictions = [model(part) for part in torch.split(images[len(targets) :], BATCH)]
    return torch.cat(predictions)


def main(source: Path, size: int, trained: int, predicted: int) -> None:
    """Train the class that a file defines on images of size x size pixels, for every line."""
    names: dict[str, type[nn.Module]] = {}
    exec(source.read_text(encoding="utf-8"), names)
    torch.manual_seed(0)
    stored = torch.randint(0, 256, (trained + predicted, 3, size, size), dtype=torch.uint8)
    images = stored.to(torch.float32, memory_format=torch.channels_last).sub_(MEAN).div_(DEVIATION)
    targets = torch.rand(trained, 3)
    print("ready", flush=True)
    for epochs in sys.stdin:
        train(names["ImageRegressionCNN"], images, targets, int(epochs))
        print("done", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
