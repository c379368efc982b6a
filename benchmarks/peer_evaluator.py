"""The evaluator that the peer of `benchmarks.peers` calls: it trains one network as a user of the peer would write it.

Nothing of this project is imported. The loop is plain PyTorch, tuned: one thread a process, images standardised once
and kept in memory, channels-last, fused Adam, any instruction set of the CPU, and the malloc settings of the process
that starts it. It takes as many steps on the same images as our trainer: full batches only, validated every epoch.
"""

import math
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn.functional import cross_entropy, mse_loss

torch.set_num_threads(1)

#: A copy of every network that was trained goes here, so that the benchmark can check which they were.
TRAINED = os.environ["PEER_TRAINED"]
EPOCHS = int(os.environ["PEER_EPOCHS"])
SEED = int(os.environ["PEER_SEED"])
BATCH, LEARNING_RATE = int(os.environ["PEER_BATCH"]), float(os.environ["PEER_LEARNING_RATE"])

#: `images` (float32, standardised), `targets`, and the rows `train` and `validation`.
DATA = {name: torch.from_numpy(array) for name, array in np.load(os.environ["PEER_DATA"]).items()}
IMAGES = DATA["images"].contiguous(memory_format=torch.channels_last)
TARGETS, TRAIN, VALIDATION = DATA["targets"], DATA["train"], DATA["validation"]
LOSS = mse_loss if TARGETS.is_floating_point() else cross_entropy


def evaluate(program_path: str) -> dict[str, float]:
    """Train the network that a file defines; return its negative loss, because the peer maximises."""
    loss = train(Path(program_path).read_text(encoding="utf-8"))
    shutil.copy(program_path, TRAINED)
    return {"combined_score": -loss}


def train(source: str) -> float:
    """Train for all epochs; return the best validation loss."""
    names: dict[str, Any] = {"torch": torch, "nn": nn, "F": nn.functional, "math": math}
    exec(source, names)
    torch.manual_seed(SEED)
    model = names[os.environ["PEER_CLASS"]]().to(memory_format=torch.channels_last)
    optimiser = torch.optim.Adam(model.parameters(), LEARNING_RATE, fused=True)
    losses = []
    for _ in range(EPOCHS):
        model.train()
        for rows in torch.split(TRAIN[torch.randperm(len(TRAIN))], BATCH):
            if len(rows) == BATCH:
                loss = LOSS(model(IMAGES[rows]), TARGETS[rows])
                optimiser.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                optimiser.step()
        model.eval()
        with torch.no_grad():
            predictions = torch.cat([model(IMAGES[rows]) for rows in torch.split(VALIDATION, BATCH)])
            losses.append(float(LOSS(predictions, TARGETS[VALIDATION])))
    return min(losses)
