"""How hard the simulated tasks are: what the baseline and networks of the grammar reach, and whether ten epochs rank.

    python -m benchmarks.difficulty force --size 64 --networks 24 --epochs 50 --out build/force-64.json

Every network is trained once for all epochs, so its ten-epoch fitness and its full training come from one run: the
learning rate is constant. The test score belongs to the epoch of the best validation loss. Training runs in plain
PyTorch with one thread a network, in bfloat16 where `--bfloat16` says so: this measures data, not bits. What is
finished stands in the file at once, and the same command goes on after it.
"""

import argparse
import json
import multiprocessing
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from scipy.stats import kendalltau, mannwhitneyu
from torch import nn

from tacevo.choices import SensorTask
from tacevo.config.compose import compose
from tacevo.data.dataset import Dataset
from tacevo.llm.grammar.instructions import transform
from tacevo.llm.grammar.parsing import parse
from tacevo.llm.grammar.rendering import render
from tacevo.randomness import stream
from tacevo.records import Kind
from tacevo.runs.datasets import load_data
from tacevo.runs.progress import Progress

LIBRARY = Path("conf/library")
BATCH = 32
#: Epochs behind a fitness.
SHORT = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One training."""

    task: str
    size: int
    epochs: int
    #: Number of the network; 0 is the baseline.
    network: int
    seed: int
    bfloat16: bool


def networks(task: str, count: int) -> list[str]:
    """Write the baseline and different descendants of it, one to four instructions away."""
    baseline = (LIBRARY / task / "baseline.py").read_text()
    library = yaml.safe_load((LIBRARY / task / "instructions.yaml").read_text())
    instructions = [entry["text"] for entry in library["mutations"]]
    found, number = [baseline], 0
    while len(found) < count:
        rng = stream(7, "difficulty", task, number)
        child, number = parse(baseline), number + 1
        for _ in range(rng.integers(1, 5)):
            child = transform(child, instructions[rng.integers(len(instructions))], rng, rng.uniform(0, 0.8))
        source = render(child)
        if source not in found:
            found.append(source)
    return found


def simulated(task: str, size: int, workers: int) -> Dataset:
    """Make or load the data set of a task at an image size."""
    settings = [f"task={task}", f"data.image_size={size}", f"executor.workers={workers}"]
    return load_data(compose(settings), Progress())


class Training:
    """One network on one data set."""

    def __init__(self, source: str, data: Dataset, *, seed: int, bfloat16: bool) -> None:
        torch.manual_seed(seed)
        self.network = build(source).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=1e-3, fused=True)
        self.images = torch.from_numpy(np.load(data.images, mmap_mode="c"))
        self.targets = torch.from_numpy(data.targets)
        self.mean = torch.tensor(data.mean).view(1, -1, 1, 1)
        self.deviation = torch.tensor(data.deviation).view(1, -1, 1, 1)
        classifies = data.facts.kind is Kind.classification
        self.loss = nn.functional.cross_entropy if classifies else nn.functional.mse_loss
        self.order = torch.Generator().manual_seed(seed)
        self.bfloat16 = bfloat16

    def epoch(self, rows: torch.Tensor) -> None:
        """Train once over `rows`, in a new order."""
        self.network.train()
        shuffled = rows[torch.randperm(len(rows), generator=self.order)]
        for batch in torch.split(shuffled, BATCH):
            if len(batch) == 1:  # BatchNorm needs two
                continue
            self.optimiser.zero_grad()
            with torch.autocast("cpu", torch.bfloat16, enabled=self.bfloat16):
                outputs = self.network(self.inputs(batch))
            self.loss(outputs.float(), self.targets[batch]).backward()  # type: ignore[no-untyped-call]
            self.optimiser.step()

    def predict(self, rows: torch.Tensor) -> torch.Tensor:
        """Return the outputs for `rows`, shape (len(rows), K)."""
        self.network.eval()
        batches = torch.split(rows, 128)
        with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=self.bfloat16):
            return torch.cat([self.network(self.inputs(batch)).float() for batch in batches])

    def inputs(self, rows: torch.Tensor) -> torch.Tensor:
        """Normalise images."""
        inputs = (self.images[rows].float() - self.mean) / self.deviation
        return inputs.to(memory_format=torch.channels_last)


def build(source: str) -> nn.Module:
    """Run the source of a network of the grammar, which is our own, and make one with its default arguments."""
    space: dict[str, Any] = {"__name__": "candidate", "torch": torch, "nn": nn, "F": nn.functional}
    exec(source, space)
    made: nn.Module = (space.get("ImageRegressionCNN") or space["SingleLabelClassCNN"])()
    return made


def train(job: Job) -> dict[str, Any]:
    """Train one network; return its validation losses and the test score of its best epoch."""
    torch.set_num_threads(1)
    data = simulated(job.task, job.size, workers=1)
    source = networks(job.task, job.network + 1)[job.network]
    training = Training(source, data, seed=job.seed, bfloat16=job.bfloat16)
    rows = {part: torch.from_numpy(getattr(data, part)) for part in ("train", "validation", "test")}
    losses: list[float] = []
    score: dict[str, Any] = {}
    start = time.perf_counter()
    for _ in range(job.epochs):
        training.epoch(rows["train"])
        loss = float(training.loss(training.predict(rows["validation"]), training.targets[rows["validation"]]))
        if loss < min(losses, default=float("inf")):
            score = scores(training.predict(rows["test"]), data)
        losses.append(loss)
    return {**asdict(job), "losses": losses, "test": score, "seconds": time.perf_counter() - start}


def scores(predictions: torch.Tensor, data: Dataset) -> dict[str, Any]:
    """Compare predictions for the test split with the truth.

    Returns:
        Classification: `accuracy`. Regression: `r2` and, averaged over the outputs, the MSE of `raw` labels in their
        squared unit, of `z`-scored labels and of `minmax` scaled ones.
    """
    truth = data.targets[data.test]
    found = predictions.numpy()
    if data.facts.kind is Kind.classification:
        return {"accuracy": float((found.argmax(axis=1) == truth).mean())}
    error = ((found - truth) ** 2).mean(axis=0)
    spread = data.targets[data.train].var(axis=0)
    return {
        "r2": (1 - error / truth.var(axis=0)).tolist(),
        "raw": float((error * np.array(data.scale) ** 2).mean()),
        "z": float((error / spread).mean()),
        "minmax": float(error.mean()),
    }


def headline(result: dict[str, Any]) -> float:
    """The test score, where more is better: accuracy, or the mean R2 over the outputs."""
    return float(result["test"].get("accuracy", np.mean(result["test"].get("r2", np.nan))))


def rank_agreement(results: list[dict[str, Any]]) -> str:
    """Correlate the short fitness with the score of the full training, over networks."""
    fitness = [-result["losses"][SHORT - 1] for result in results]
    tau = kendalltau(fitness, [headline(result) for result in results])
    return f"Kendall's tau of -loss at epoch {SHORT} with the test score: {tau.statistic:.2f} (p = {tau.pvalue:.1g})"


def seeds_apart(results: list[dict[str, Any]], network: int) -> str:
    """Test whether a network's scores differ from the baseline's over seeds: Mann-Whitney's U, two-sided, exact."""
    ours, baseline = (
        [headline(result) for result in results if result["network"] == number] for number in (network, 0)
    )
    p = mannwhitneyu(ours, baseline, method="exact").pvalue
    medians = f"{np.median(ours):.4f} against the baseline's {np.median(baseline):.4f}"
    return f"network {network} over {len(ours)} and {len(baseline)} seeds: median test score {medians}, p = {p:.2g}"


def main() -> None:
    """Train what is asked for and not yet in the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", choices=sorted(SensorTask))
    parser.add_argument("--size", type=int, default=64, metavar="PIXELS")
    parser.add_argument("--networks", type=int, default=1, metavar="N", help="the baseline and N - 1 of the grammar")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="training seeds of each network")
    parser.add_argument("--epochs", type=int, default=50, metavar="N")
    parser.add_argument("--workers", type=int, default=2, metavar="N")
    parser.add_argument("--bfloat16", action="store_true", help="quicker where the CPU knows it")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE")
    options = parser.parse_args()
    results: list[dict[str, Any]] = json.loads(options.out.read_text()) if options.out.exists() else []
    wanted = [
        Job(
            task=options.task,
            size=options.size,
            epochs=options.epochs,
            network=network,
            seed=seed,
            bfloat16=options.bfloat16,
        )
        for seed in range(options.seeds)
        for network in range(options.networks)
    ]
    done = [{key: result[key] for key in asdict(wanted[0])} for result in results]
    simulated(options.task, options.size, options.workers)
    for result in _trained([job for job in wanted if asdict(job) not in done], options.workers):
        results.append(result)
        _write(options.out, results)
        at_ten, last = result["losses"][:SHORT][-1], result["losses"][-1]
        print(
            f"network {result['network']} seed {result['seed']}: loss {at_ten:.5f} at {SHORT}, {last:.5f} at the end; "
            f"test {headline(result):.4f}; {result['seconds']:.0f} s",
            flush=True,
        )
    if options.networks > 1 and options.epochs > SHORT:
        print(rank_agreement([result for result in results if result["seed"] == 0]))
    for network in range(1, options.networks if options.seeds > 1 else 1):
        print(seeds_apart(results, network))


def _write(path: Path, results: list[dict[str, Any]]) -> None:
    """Replace the results in one step: hours of training stand in them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(results))
    part.replace(path)


def _trained(jobs: list[Job], workers: int) -> Iterator[dict[str, Any]]:
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield from pool.imap_unordered(train, jobs)


if __name__ == "__main__":
    main()
