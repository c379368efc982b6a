"""How long a search takes on this machine, from the baseline trained for some seconds on images of noise.

It is an estimate: candidates are other networks, the machine may be busier or less so later, and nobody knows how
long answers take. docs/scale.md compares it with searches that were run.
"""

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tacevo.choices import Device, ExecutorKind
from tacevo.config.schema import OutputConfig, RunConfig, StoreConfig
from tacevo.config.tasks import facts_without_data, load_task
from tacevo.data.dataset import Dataset
from tacevo.data.loading import split_rows
from tacevo.environment import usable_cores
from tacevo.errors import RunError
from tacevo.randomness import stream
from tacevo.records import Kind, Mode, Rejection
from tacevo.rules import CURRENT
from tacevo.runs.datasets import source_of
from tacevo.runs.wiring import Workbench, check_means
from tacevo.training.leases import visible_gpus

#: How much longer than the baseline's a candidate's training takes, in the mean of 80 networks drawn from the two
#: published searches, and how many generations these had. A shorter search is taken to have less of it (docs/scale.md).
GROWTH, GROWN = 0.7, 20

#: Seconds that the baselines train beyond their start, at least, so that the clock and the load matter little.
_SECONDS = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How fast a machine trains the baseline, with several trainings at once."""

    #: Trainings, as of `trainings_at_once`.
    at_once: int
    #: Trained on by all of them together, with the predictions of the validation images between.
    images_per_second: float
    #: What a training takes besides its epochs, and what the gate takes for a network, in seconds.
    start: float
    gate: float
    #: Processes that wanted each core before: from 1 on, the trainings had to share.
    load: float = 0.0

    def seconds(self, config: RunConfig, images: int) -> float:
        """Return how long the trainings of a search take that has so many training images, without the answers.

        A cluster is taken to have as many such machines as its workers need.
        """
        trained = growth(config) * config.training.epochs * images / self.images_per_second
        waited = (self.start + self.gate / config.training.seeds) / self.at_once
        machines = 1.0 if config.executor.kind is ExecutorKind.local else config.executor.workers / self.at_once
        return trainings(config) * (trained + waited) / machines


#: Measures the pace of a configuration on this machine.
Measure = Callable[[RunConfig], Pace]


def growth(config: RunConfig) -> float:
    """Return the time of a candidate's training, in the mean over a search, for one of the baseline's."""
    return 1 + GROWTH * min(config.search.generations / GROWN, 1)


def trainings(config: RunConfig) -> int:
    """Return how many trainings a search has at most: every candidate is admitted, and no two are equal."""
    search = config.search
    return (1 + search.initial + search.generations * search.candidates) * config.training.seeds


def trainings_at_once(config: RunConfig) -> int:
    """Return how many trainings run here together: one for each worker, core and share of a GPU; at least one."""
    is_on_cpu = config.training.device is Device.cpu
    places = usable_cores() if is_on_cpu else config.executor.per_gpu * len(visible_gpus())
    return max(1, min(config.executor.workers, places))


def training_images(config: RunConfig) -> int:
    """Return how many images the training split has.

    Raises:
        DataError, ConfigError: the data set is not there, or cannot be used or split so.
    """
    data = config.data
    return len(split_rows(source_of(config).catalogue(), data.split, data.split_seed, data.held_out).train)


def measure(config: RunConfig) -> Pace:
    """Train baselines on this machine as a search trains candidates, until that took some seconds; nothing is kept.

    Raises:
        ConfigError: this machine cannot compute as the configuration asks.
        SandboxError: the sandbox is broken, or is not as strong as asked.
        RunError: the baseline does not train.
    """
    executor = replace(config.executor, kind=ExecutorKind.local, workers=trainings_at_once(config))
    check_means(replace(config, executor=executor))
    load = os.getloadavg()[0] / (os.cpu_count() or 1)  # of the whole machine
    with tempfile.TemporaryDirectory() as folder:
        here = replace(config, store=StoreConfig(root=folder), run=OutputConfig(dir=folder), executor=executor)
        task, data = load_task(here, facts_without_data(here)), noise(here, Path(folder))
        with Workbench(here, task, data.facts, Mode.live, data=data) as bench:
            gate = bench.gate(CURRENT)
            gate.measure(task.baseline)  # starts the process that all others are forked from
            judged = _timed(lambda: gate.measure(task.baseline))

            def train(epochs: int) -> float:
                """Return the seconds of so many epochs of each worker's baseline."""
                bench.config = replace(here, training=replace(here.training, epochs=epochs))
                evaluator = bench.evaluator(CURRENT)
                seeds = range(here.executor.workers)
                return _timed(
                    lambda: _check(list(bench.executor.map(lambda seed: evaluator.retrain(task.baseline, seed), seeds)))
                )

            least, epochs = train(1), 2
            while (took := train(epochs) - least) < _SECONDS:
                epochs *= 2
    of_epoch = took / (epochs - 1)
    return Pace(
        at_once=here.executor.workers,
        images_per_second=here.executor.workers * len(data.train) / of_epoch,
        start=max(0.0, least - of_epoch),
        gate=judged,
        load=load,
    )


def _timed(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def _check(verdicts: list[object]) -> None:
    for verdict in verdicts:
        if isinstance(verdict, Rejection):
            raise RunError(f"{verdict.reason}: {verdict.detail}", place="the baseline", expected="one that trains")


def _predicted(config: RunConfig) -> int:
    """Return how many images are predicted for each batch that is trained on, by the parts that are held out.

    Four times the batch at most: an epoch of little but predictions needs no more to be measured.
    """
    (validation, test), batch = config.data.held_out, config.training.batch_size
    trained = max(1 - validation - test, validation / 4)
    return max(1, round(batch * validation / trained))


def noise(config: RunConfig, folder: Path) -> Dataset:
    """Make a batch of images of noise to train on, and some to predict, with labels that mean nothing."""
    batch, facts = config.training.batch_size, facts_without_data(config)
    count, draws = batch + _predicted(config), stream(0, "pace")
    size = (facts.in_channels, facts.image_size, facts.image_size)
    np.save(folder / "images.npy", draws.integers(0, 256, (count, *size), dtype=np.uint8))
    rows, outputs = np.arange(count), facts.outputs
    values = draws.random((count, outputs), dtype=np.float32)
    return Dataset(
        facts=facts,
        images=folder / "images.npy",
        targets=values if facts.kind is Kind.regression else rows % outputs,
        train=rows[:batch],
        validation=rows[batch:],
        test=rows[:0],
        mean=(127.5,) * facts.in_channels,
        deviation=(74.0,) * facts.in_channels,
        offset=(0.0,) * outputs,
        scale=(1.0,) * outputs,
    )
