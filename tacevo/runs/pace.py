"""The pace of a search on this machine, and the gain by AVX-512, from the baseline trained on images of noise.

It is an estimate: candidates are other networks, the machine may be busier or less so later, and nobody knows how
long answers take. docs/scale.md compares it with searches that were run.
"""

import contextlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

from tacevo.choices import Device, Numerics
from tacevo.config.schema import OutputConfig, RunConfig, StoreConfig
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.data.dataset import Dataset
from tacevo.data.loading import split_rows
from tacevo.errors import RunError, TacevoError
from tacevo.parts.facts import HERE
from tacevo.randomness import stream
from tacevo.records import Kind, Mode, Rejection
from tacevo.rules import CURRENT
from tacevo.runs.datasets import source_of
from tacevo.runs.local import trainings_at_once
from tacevo.runs.wiring import Workbench, check_means

#: The share by which a candidate's training is longer than the baseline's, in the mean of 80 networks drawn from the
#: two published searches, and the number of generations that these had. A shorter search is taken to have less of it
#: (docs/scale.md).
GROWTH, GROWN = 0.7, 20

#: Seconds that the baselines train beyond their start, at least, so that the clock and the load matter little.
_SECONDS = 3.0

#: Seconds of the processor that a turn takes, at least, where two numerics are compared.
_TURN = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """The pace at which a machine trains the baseline, with several trainings at once."""

    #: Trainings, as of `trainings_at_once`.
    at_once: int
    #: The images that all of them together train on in a second, with the predictions of the validation images between.
    images_per_second: float
    #: The time of a training besides its epochs, and of the gate for a network, in seconds.
    start: float
    gate: float
    #: Processes that wanted each core before: from 1 on, the trainings had to share.
    load: float = 0.0

    def seconds(self, config: RunConfig, images: int) -> float:
        """Return how long the trainings of a search take that has so many training images, without the answers.

        A cluster is taken to have as many such machines as its workers need.
        """
        trained = growth(config) * config.training.epochs * images / self.images_per_second
        waited = (self.start + self.gate) / self.at_once
        machines = 1.0 if config.executor.is_here else config.executor.workers / self.at_once
        return trainings(config) * (trained + waited) / machines


#: Measures the pace of a configuration on this machine.
Measure = Callable[[RunConfig], Pace]

#: Measures what `part_saved` returns.
Saving = Callable[[RunConfig, int], float]


def growth(config: RunConfig) -> float:
    """Return the time of a candidate's training, in the mean over a search, for one of the baseline's."""
    return 1 + GROWTH * min(config.search.generations / GROWN, 1)


def trainings(config: RunConfig) -> int:
    """Return how many trainings a search has at most: every candidate is admitted, and no two are equal."""
    search = config.search
    return 1 + search.initial + search.generations * search.candidates


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
    workers = trainings_at_once(config)
    load = os.getloadavg()[0] / (os.cpu_count() or 1)  # of the whole machine
    with _baseline(config, workers) as (bench, source):
        gate = bench.gate(CURRENT)
        gate.measure(source)  # starts the process that all others are forked from
        judged = _timed(lambda: gate.measure(source))

        def train(epochs: int) -> float:
            """Return the seconds of so many epochs of each worker's baseline."""
            return _timed(lambda: list(bench.executor.map(partial(_train, bench, source, epochs), range(workers))))

        if config.training.device is Device.cuda:
            train(1)  # the first one waits until the GPUs were looked at
        least, epochs = train(1), 2
        while (took := train(epochs) - least) < _SECONDS:
            epochs *= 2
    of_epoch = took / (epochs - 1)
    return Pace(
        at_once=workers,
        images_per_second=workers * config.training.batch_size / of_epoch,
        start=max(0.0, least - of_epoch),
        gate=judged,
        load=load,
    )


def part_saved(config: RunConfig, images: int) -> float:
    """Measure which part of the time of a training on so many images `numerics=portable512` would save.

    It is the processor time of the baseline. The two levels take turns, so that both meet the same load: some ten
    seconds of one core, and nothing is kept.

    Returns:
        A number in [0, 1): 0 where it saves nothing, trainings run elsewhere or with other numerics, this CPU lacks
        AVX-512, or the baseline does not train.
    """
    is_here = config.executor.is_here and config.training.device is Device.cpu
    if not (is_here and config.numerics.kind is Numerics.portable):
        return 0.0
    faster = replace(config, numerics=replace(config.numerics, kind=Numerics.portable512))
    try:
        with _baseline(faster, 1) as fast, _baseline(config, 1) as slow:
            least, epochs = [_cpu_seconds(*each, 1) for each in (slow, fast)], 2
            while _cpu_seconds(*slow, epochs) - least[0] < _TURN:
                epochs *= 2
            turns = [[_cpu_seconds(*each, epochs) for each in (slow, fast)] for _ in range(3)]
    except (TacevoError, OSError):  # a hint never ends a search
        return 0.0
    more = config.training.epochs * images / config.training.batch_size - 1
    costs: list[float] = [
        one + more * (median(several) - one) / (epochs - 1)
        for one, several in zip(least, zip(*turns, strict=True), strict=True)
    ]
    return max(0.0, 1 - costs[1] / costs[0])


@contextlib.contextmanager
def _baseline(config: RunConfig, workers: int) -> Iterator[tuple[Workbench, str]]:
    """Open what trains the baseline on one batch of noise, by so many workers; yield that and its source."""
    executor = replace(config.executor, kind=HERE, workers=workers)
    check_means(replace(config, executor=executor))
    with tempfile.TemporaryDirectory() as folder:
        here = replace(config, store=StoreConfig(root=folder), run=OutputConfig(dir=folder), executor=executor)
        task, data = load_task(here, facts_without_data(here)), noise(here, Path(folder))
        with Workbench(here, task, data.facts, Mode.live, data=data) as bench:
            yield bench, task.baseline


def _train(bench: Workbench, source: str, epochs: int, seed: int) -> None:
    """Train for so many epochs, which have one step each.

    Raises:
        RunError: the baseline does not train.
    """
    bench.config = replace(bench.config, training=replace(bench.config.training, epochs=epochs))
    verdict = bench.evaluator(CURRENT).retrain(source, seed)
    if isinstance(verdict, Rejection):
        raise RunError(f"{verdict.reason}: {verdict.detail}", place="the baseline", expected="one that trains")


def _cpu_seconds(bench: Workbench, source: str, epochs: int) -> float:
    """Train in this thread, and return the processor time."""
    before = bench.cpu_seconds()
    _train(bench, source, epochs, 0)
    return bench.cpu_seconds() - before


def _timed(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


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
