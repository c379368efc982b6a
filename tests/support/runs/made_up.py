"""Made-up tables of a space: random losses in place of trainings, to test and to measure what reads a table."""

import hashlib
from dataclasses import replace
from pathlib import Path

from tacevo.config.compose import compose
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.profile import Admitted, Graph, Node, Profile
from tacevo.randomness import stream
from tacevo.records import Reason, Rejection, Stage, Training
from tacevo.results.gene_model import put_first
from tacevo.results.space_table import write_table
from tacevo.results.table_records import SpaceTable, TableTraining
from tacevo.runs.seeds import judge_seed
from tacevo.studies.tabulate import header_of, members, network_of
from tacevo.training.full import FullTraining, StoredPredictions
from tacevo.training.metrics import counted_metrics

#: A space of eight networks, which a table holds beside the baseline's file.
TINY = (
    "tracking=none",
    "llm.space.depth=[2]",
    "llm.space.width=[16]",
    "llm.space.activation=[relu]",
    "llm.space.norm=[none]",
    "llm.space.down=[max]",
    "llm.space.pooling=[average]",
    "archive.niches=5",
    "archive.prompt_niches=5",
    "archive.samples=100",
    "search.generations=2",
)


def made_up_table(path: Path, *overrides: str, seeds: int = 3, failing: int | None = None) -> SpaceTable:
    """Write the table of `experiment=space` with these overrides; the network of a row may fail with every seed."""
    config = compose(["experiment=space", *overrides])
    names = tuple(f"{spacing:g} mm" for spacing in config.data.spacings_mm)
    facts = replace(facts_without_data(config), names=names, fingerprint="f" * 64, counts=(400, 200, 1400))
    task = load_task(config, facts)
    header = header_of(config, task, facts, 1.94, seeds=seeds, made_up=True)
    rows = [
        network_of(Admitted(source=source, profile=_profile(row)), genome, source)
        for row, (genome, source) in enumerate(members(config, task))
    ]
    trainings = [
        _training(row, seed, config.training.epochs, failed=row == failing)
        for row in range(len(rows))
        for seed in range(len(header.seeds))
    ]
    return write_table(path, header, rows, trainings)


def _profile(row: int) -> Profile:
    ops = ("conv2d", "relu", "max_pool2d", "conv2d", "relu", "flatten", "linear", "relu", "linear")
    nodes = tuple(Node(op=op, weighted=op in {"conv2d", "linear"}, width=16 + row % 48) for op in ops)
    edges = tuple((index, index + 1) for index in range(len(nodes) - 1))
    graph = Graph(nodes=nodes, edges=edges, channels=(16, 32 + row), kernels=(3.0, 3.0), hidden=(256,))
    return Profile(parameters=10_000 + 997 * row, flops=1_000_000 + 7919 * row, modules=9, graph=graph)


def _training(row: int, seed: int, epochs: int, *, failed: bool) -> TableTraining:
    """Draw a curve that falls towards a level of the network's own, with noise of each epoch."""
    if failed:
        rejection = Rejection(stage=Stage.train, reason=Reason.not_finite, detail="made up")
        return TableTraining(network=row, seed=seed, rejection=rejection)
    level = 0.3 + stream(0, "made up", row).random()
    rng = stream(0, "made up", row, seed)
    curve = [float(f"{level + 1.6 / (epoch + 1) + 0.1 * rng.random():.9g}") for epoch in range(epochs)]
    digest = hashlib.sha256(f"made up {row} {seed}".encode()).hexdigest()
    epoch = curve.index(min(curve)) + 1
    training = Training(
        train_losses=tuple(loss * 0.9123456789 for loss in curve),
        validation_losses=tuple(curve),
        predictions_sha256=digest,
        weights_sha256=hashlib.sha256(digest.encode()).hexdigest(),
    )
    # 200 test images a class; few enough wrong ones that any of these losses can be theirs
    counts = [rng.multinomial(200, [0.8 if own == other else 0.2 / 6 for other in range(7)]) for own in range(7)]
    confusion = tuple(tuple(row.tolist()) for row in counts)
    return TableTraining(
        network=row,
        seed=seed,
        full=FullTraining(
            training=training,
            epoch=epoch,
            metrics={"cross_entropy": min(curve), **counted_metrics(confusion)},
            confusion=confusion,
            kept=StoredPredictions(predictions=digest, labels="f" * 64),
        ),
    )


def made_up_judge(path: Path, table: SpaceTable, *, networks: int = 3, seeds: int = 4) -> SpaceTable:
    """Write a made-up table with a judge, for which nothing was trained either."""
    fresh = tuple(judge_seed(table.header.settings.seed, number) for number in range(seeds))
    epochs = table.header.settings.training.epochs
    trainings = [
        replace(_training(row, 100 + seed, epochs, failed=False), seed=seed)
        for row in put_first(table, networks)
        for seed in range(seeds)
    ]
    judge = replace(table.header, seeds=fresh), trainings
    return write_table(path, table.header, table.networks, table.trainings, judge)
