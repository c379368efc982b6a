"""A finished run of any size without training: real requests, answers, gate and files over a made-up sandbox.

The sources are those of the grammar provider. Every probe gives the baseline's measured profile with sizes that follow
from the source, and every training predicts values that do; so stores and ledger are as large as those of a real run of
as many candidates.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tacevo.config.compose import compose
from tacevo.config.schema import RunConfig
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.data.dataset import Dataset
from tacevo.profile import Profile
from tacevo.records import DataFacts, Limits, Mode, Task, to_json
from tacevo.rules import CURRENT
from tacevo.runs.progress import Progress
from tacevo.runs.session import Result, record
from tacevo.runs.wiring import Workbench
from tacevo.sandbox.client import Died, Finished, Frame, RunJob

#: Images of the data set, which does not exist; few, because a made-up training predicts values for each.
_TRAINED, _VALIDATED = 32, 8

_IMAGES = _TRAINED + 2 * _VALIDATED

_FINGERPRINT = hashlib.sha256(b"a data set that is not there").hexdigest()


def record_synthetic(folder: Path, generations: int, view: Progress) -> Result:
    """Record a run of 50 candidates a generation, in `folder`/run with its stores in `folder`/cache.

    Args:
        folder: where to write.
        generations: 20 for the paper's size.
        view: shows the progress.
    """
    config, task, facts = synthetic_setting(folder, generations)
    run = made_up(profile_of_baseline(config, task, facts), config.training.epochs, facts.outputs)
    return record(config, task, synthetic_dataset(facts), view, run=run)


def synthetic_setting(folder: Path, generations: int) -> tuple[RunConfig, Task, DataFacts]:
    """Return the configuration, the task and the data facts of such a run."""
    places = [f"run.dir={folder}/run", f"store.root={folder}/cache"]
    size = [f"search.generations={generations}", "search.candidates=50", "executor.workers=1", "tracking=none"]
    config = compose(["experiment=paper_force", "llm=grammar", f"data.images={_IMAGES}", *size, *places])
    facts = replace(facts_without_data(config), fingerprint=_FINGERPRINT, counts=(_TRAINED, _VALIDATED, _VALIDATED))
    return config, load_task(config, facts), facts


def profile_of_baseline(config: RunConfig, task: Task, facts: DataFacts) -> Profile:
    """Probe the baseline in a real sandbox, once."""
    with Workbench(config, task, facts, Mode.record) as bench:
        judged = bench.gate(CURRENT).inspect(task.baseline)
    if not hasattr(judged, "profile"):
        raise RuntimeError(f"the baseline was rejected: {judged}")
    return judged.profile


def made_up(baseline: Profile, epochs: int, outputs: int) -> RunJob:
    """Answer probes and trainings with frames that follow from the source alone."""

    def run(entry: str, header: Any, payload: bytes, limits: Limits, *_: object) -> Finished | Died:
        rng = np.random.default_rng(list(hashlib.sha256(header["source"].encode()).digest()))
        if entry == "probe":
            return Finished((Frame({"profile": to_json(_resized(baseline, rng))}, b""),))
        batch = header["recipe"]["batch_size"]
        return Finished(tuple(_trained(rng, epochs, outputs, max(1, header["train"] // batch))))

    return run


def _resized(profile: Profile, rng: np.random.Generator) -> Profile:
    """Return a profile with other sizes, so that candidates spread over the archive."""
    channels = tuple(int(value) for value in rng.integers(8, 256, size=len(profile.graph.channels)))
    return replace(
        profile,
        parameters=int(profile.parameters * rng.uniform(0.2, 2.0)),
        flops=int(profile.flops * rng.uniform(0.2, 2.0)),
        graph=replace(profile.graph, channels=channels),
    )


def _trained(rng: np.random.Generator, epochs: int, outputs: int, steps: int) -> Iterator[Frame]:
    """Return the frames of a training whose losses fall; `steps` are those of one epoch."""
    spread = rng.uniform(0.05, 0.3)
    for epoch in range(epochs):
        values = (0.5 + rng.normal(size=(_VALIDATED, outputs)) * spread / (1 + epoch)).astype(np.float32)
        told = {"epoch": epoch, "train_loss": float(spread / (1 + epoch)), "steps": (epoch + 1) * steps}
        yield Frame(told, values.tobytes())
    yield Frame({"weights_sha256": hashlib.sha256(rng.bytes(32)).hexdigest()}, b"")


def synthetic_dataset(facts: DataFacts) -> Dataset:
    """Return labels that are all alike, for images that do not exist."""
    train, validation, test = np.split(np.arange(sum(facts.counts)), np.cumsum(facts.counts)[:2])
    return Dataset(
        facts=facts,
        images=Path("absent.npy"),
        targets=np.full((sum(facts.counts), facts.outputs), 0.5, np.float32),
        train=train,
        validation=validation,
        test=test,
        mean=(0.0,) * facts.in_channels,
        deviation=(1.0,) * facts.in_channels,
        offset=(0.0,) * facts.outputs,
        scale=(1.0,) * facts.outputs,
    )
