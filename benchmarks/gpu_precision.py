"""What tf32 and bf16 cost in loss: 20 published networks trained in each precision, with the same seed and data.

    python -m benchmarks.gpu_precision [cpu [EPOCHS]]

The networks are trained ones of a published search that Claude wrote, from the fewest FLOPs to the most, in that
search's own setting: gratings of 48 px, 560 images, six epochs unless a number says otherwise. For each precision: the
rank correlation (Spearman) of fitness with float32's, and the loss by float32's. A further row trains in float32 with
another seed: what differs less than that is lost in the noise of a training. On a CPU, TF32 is float32, and bf16 is not
computed by a GPU's kernels.
"""

import itertools
import os
import statistics
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.stats import spearmanr

from benchmarks.gpu import networks
from tacevo.bundles.open import opened
from tacevo.choices import Device, Numerics, Precision
from tacevo.config.schema import RunConfig, StoreConfig
from tacevo.config.task_texts import load_task
from tacevo.data.dataset import Dataset
from tacevo.parts import Fitness
from tacevo.parts.kinds import FITNESS
from tacevo.parts.registry import of_settings
from tacevo.records import Gpu, Json, Limits, Rejection
from tacevo.results.run import read_run
from tacevo.runs.datasets import examples_of, load_data
from tacevo.runs.progress import Progress
from tacevo.runs.seeds import training_seed
from tacevo.runs.wiring import recipe_of
from tacevo.sandbox.client import Finished, Frame, Score
from tacevo.text import table
from tacevo.training.captured import capture
from tacevo.training.evaluation import Setting
from tacevo.training.gpu import Resident, multiply_in
from tacevo.training.numerics import environment
from tacevo.training.trainer import run as train

PUBLISHED = Path("cache/published/grating-claude.zip")
COUNT = 20

#: The fitness of each network; None where its training ended without one.
Fitnesses = Sequence[float | None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bench:
    """What all trainings share; they run in this process, one after the other."""

    config: RunConfig
    data: Dataset
    device: torch.device

    def fitnesses(self, sources: Sequence[str], precision: Precision, seed: int) -> Fitnesses:
        """Train each network."""
        multiply_in(precision)
        is_captured = self.device.type == "cuda"
        gpu = Gpu(model="any", precision=precision, memory_mib=8192, captured=is_captured)
        setting = Setting(
            contract=load_task(self.config, self.data.facts).contract,
            fingerprint=self.data.facts.fingerprint,
            recipe=replace(recipe_of(self.config), gpu=gpu),
            numerics=Numerics.fast,
            device=Device(self.device.type),
        )
        examples = examples_of(self.data)
        stored, rows = np.load(self.data.images, mmap_mode="r"), np.concatenate([examples.train, examples.validation])
        arrays: dict[str, Any] = {"images": Resident(stored, rows, self.device) if is_captured else stored}
        arrays |= {"capture": capture} if is_captured else {}

        def here(entry: str, header: Json, payload: bytes, limits: Limits, score: Score | None = None) -> Finished:
            frames: list[Frame] = []
            train(header, payload, arrays, lambda head, data: frames.append(Frame(head, data)))
            return Finished(tuple(frames))

        training = self.config.training
        rule: Fitness = of_settings(FITNESS, training.fitness, training)

        def fitness(source: str) -> float | None:
            outcome = setting.train(here, source, seed, examples=examples, predicted=[examples.validation])
            verdict = setting.judge(outcome, examples, rows=len(examples.validation))
            if isinstance(verdict, Rejection):
                return None
            return rule.of(verdict[0].validation_losses)

        return [fitness(source) for source in sources]


def compared(plain: Fitnesses, others: Mapping[str, Fitnesses]) -> str:
    """Compare fitnesses with those of float32, in a table; a row needs two networks that trained both times."""
    rows = []
    for name, fitnesses in others.items():
        pairs = [
            (one, other)
            for one, other in zip(plain, fitnesses, strict=True)
            if one is not None and other is not None and one > 0
        ]
        ratios = sorted(other / one for one, other in pairs)
        rank = spearmanr([one for one, _ in pairs], [other for _, other in pairs]).statistic
        shown = [f"{rank:.3f}", *(f"{value:.4f}" for value in (statistics.median(ratios), ratios[0], ratios[-1]))]
        rows.append([name, f"{len(pairs)} of {len(plain)}", *shown])
    head = ["trained in", "networks", "rank correlation", "loss by float32's: median", "least", "most"]
    return table(head, rows)


def measured(bench: Bench, sources: Sequence[str]) -> str:
    """Train all networks in each precision, and once more with another seed; return the table."""
    seed, other = (training_seed(bench.config.seed, number) for number in range(2))
    plain = bench.fitnesses(sources, Precision.float32, seed)
    others = {str(each): bench.fitnesses(sources, each, seed) for each in (Precision.tf32, Precision.bf16)}
    return compared(plain, {**others, "float32, another seed": bench.fitnesses(sources, Precision.float32, other)})


def opened_bench(device: torch.device, folder: str, *, images: int | None = None, epochs: int | None = None) -> Bench:
    """Make the data of the published search, in a folder of their own; with fewer images and epochs where asked for."""
    (path,) = opened(PUBLISHED).runs
    config = replace(read_run(path).config, store=StoreConfig(root=folder))
    data, training = config.data, config.training
    config = replace(
        config,
        data=replace(data, images=images or data.images),
        training=replace(training, epochs=epochs or training.epochs),
    )
    with Progress() as view:
        return Bench(config=config, data=load_data(config, view), device=device)


def main(arguments: Sequence[str]) -> int:
    """Measure on a GPU, or on a CPU where that is asked for, in so many epochs."""
    device = torch.device(arguments[0] if arguments else "cuda")
    if device.type == "cuda" and not torch.cuda.is_available():
        print("no CUDA device that torch can use; nothing was measured", file=sys.stderr)
        return 2
    os.environ.update(environment(Numerics.fast, Device(device.type)))  # cuBLAS reads its own when it starts
    sources = [source for _, source in itertools.islice(networks(COUNT, PUBLISHED), 1, None)]  # without the baseline
    name = torch.cuda.get_device_name(0) if device.type == "cuda" else "CPU"
    with tempfile.TemporaryDirectory() as folder:
        bench = opened_bench(device, folder, epochs=int(arguments[1]) if len(arguments) > 1 else None)
        data, epochs = bench.config.data, bench.config.training.epochs
        print(f"{name}, torch {torch.__version__}, {len(sources)} networks")
        print(f"{data.image_size} px, {data.images} images, {epochs} epochs")
        print(f"\n{measured(bench, sources)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
