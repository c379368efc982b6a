"""`tacevo tabulate`: every network of a closed space, probed, and trained fully with each of some seeds.

The trainings are those of studies, in the same store: a table that was stopped goes on where it was, and any executor
makes the same one. What costs most begins first, so that no long training is left alone at the end.
"""

import hashlib
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from pathlib import Path

from tacevo.config.schema import ExecutorConfig, RunConfig
from tacevo.config.task_texts import load_task
from tacevo.data.dataset import Dataset
from tacevo.environment import machine, versions
from tacevo.errors import ConfigError, telling
from tacevo.llm.grammar.parsing import UnreadableError, parse
from tacevo.llm.grammar.rendering import render
from tacevo.llm.grammar.space import Genome, genomes, member
from tacevo.parts.facts import HERE
from tacevo.profile import Admitted
from tacevo.records import DataFacts, Mode, Rejection, Task, to_json
from tacevo.results.publishable import published_config
from tacevo.results.space_table import check_networks, check_size, write_table
from tacevo.results.table_records import Header, SpaceTable, TableNetwork, TableTraining
from tacevo.rules import CURRENT, STUDY
from tacevo.runs.datasets import load_data, trivial_of
from tacevo.runs.progress import Progress
from tacevo.runs.seeds import training_seed
from tacevo.runs.wiring import Workbench, check_means, started_ahead
from tacevo.text import counted, lasting

#: Lines that say how much is done, over a whole table.
_TOLD = 20


def tabulate(config: RunConfig, target: Path, view: Progress, *, seeds: int = 1) -> SpaceTable:
    """Train every network of `llm.space` as `training` says, with so many seeds, and write their table.

    Raises:
        ConfigError: the configuration has no space, its data are a table, or its trainings are too many for a file.
        BundleError: its networks are.
        TacevoError: see its subclasses; what was computed so far is kept.
        KeyboardInterrupt: the user stopped it; the same command continues.
    """
    if config.llm.space is None:
        raise ConfigError("null", place="llm.space", expected="a closed space", remedy="set llm=grammar_space")
    if config.data.facts.is_looked_up:
        raise ConfigError("table", place="data", expected="images to train on")
    check_means(config)
    with started_ahead(config) as started:
        data = load_data(config, view)
        task = load_task(config, data.facts)
        with Workbench(config, task, data.facts, Mode.record, data=data, say=view.say, started=started) as bench:
            header = header_of(config, task, data.facts, trivial_of(config, task, data), seeds=seeds)
            every = members(config, task)
            check_size(header, len(every))
            with telling(lambda: True):  # whatever has ended is in the stores
                networks = _probed(bench, every, view)
                check_networks(target, networks)
                trainings = train_rows(bench, header.seeds, dict(enumerate(networks)), data, view)
    return write_table(target, header, networks, trainings)


def header_of(
    config: RunConfig, task: Task, facts: DataFacts, trivial: float, *, seeds: int, made_up: bool = False
) -> Header:
    """Return what the rows of a configuration's table follow from."""
    return Header(
        made_up=made_up,
        config=published_config(to_json(replace(config, executor=ExecutorConfig(kind=HERE, workers=1)))),
        task=task,
        data=facts,
        seeds=tuple(training_seed(config.seed, number) for number in range(seeds)),
        rules=CURRENT,
        study=STUDY,
        trivial=trivial,
        versions=versions(),
        machine=machine(),
    )


def members(config: RunConfig, task: Task) -> list[tuple[Genome | None, str]]:
    """List the task's baseline, as its file has it, and every network of a configuration's space: genome and source.

    Raises:
        ConfigError: the grammar cannot read the baseline.
    """
    assert config.llm.space is not None  # as `tabulate` checks
    try:
        signature = parse(task.baseline).signature
    except UnreadableError as error:
        raise ConfigError(str(error), place="task.baseline", expected="a class that the grammar reads") from error
    return [(None, task.baseline), *((each, render(member(each, signature))) for each in genomes(config.llm.space))]


def _probed(bench: Workbench, networks: Sequence[tuple[Genome | None, str]], view: Progress) -> list[TableNetwork]:
    gate, rows = bench.gate(CURRENT), []
    view.say(f"{counted(len(networks), 'network')}: the gate measures each")
    before = [gate.is_measured(source) for _, source in networks]
    for row in bench.executor.map(lambda pair: network_of(gate.inspect(pair[1]), *pair), networks):
        rows.append(row)
        view.advance("networks", len(rows), len(networks), recalled=before[len(rows) - 1])
    return rows


def network_of(verdict: Admitted | Rejection, genome: Genome | None, source: str) -> TableNetwork:
    """Return the row of a network that the gate has judged."""
    return TableNetwork(
        genome=None if genome is None else dict(genome),
        source=source,
        sha256=hashlib.sha256(source.encode()).hexdigest(),
        profile=None if isinstance(verdict, Rejection) else verdict.profile,
        rejection=verdict if isinstance(verdict, Rejection) else None,
    )


def train_rows(
    bench: Workbench,
    seeds: Sequence[int],
    networks: Mapping[int, TableNetwork],
    data: Dataset,
    view: Progress,
    *,
    number: int = 0,
    parts: int = 1,
) -> list[TableTraining]:
    """Train each network with each seed, or one part of these, and say how much is left, by FLOPs.

    Args:
        bench: what trains.
        seeds: the training seeds.
        networks: of the rows of a table.
        data: to train on.
        view: shows the progress.
        number: of the part, in [0, parts).
        parts: of about equal cost.

    Returns:
        The trainings by network, in the order given, then by seed.
    """
    evaluator = bench.studies(STUDY, data.scale)
    costs = {
        (row, seed): network.profile.training_flops
        for row, network in networks.items()
        if network.profile is not None
        for seed in range(len(seeds))
    }
    order = sorted(costs, key=lambda job: -costs[job])[number::parts]
    recorded = {job for job in order if evaluator.is_recorded(networks[job[0]].source, seeds[job[1]])}
    view.say(f"{counted(len(order), 'training')}, {len(recorded)} of them recorded already")
    left, began, done = sum(costs[job] for job in order if job not in recorded), time.monotonic(), 0
    total, rows = left, {}
    futures = {
        bench.executor.submit(evaluator.evaluate, networks[row].source, seeds[seed]): (row, seed) for row, seed in order
    }
    for future in as_completed(futures):
        job, verdict = futures[future], future.result()
        rows[job] = TableTraining(
            network=job[0],
            seed=job[1],
            full=None if isinstance(verdict, Rejection) else verdict,
            rejection=verdict if isinstance(verdict, Rejection) else None,
        )
        view.advance("trainings", len(rows), len(order), recalled=job in recorded)
        if job in recorded:
            if left == total:  # nothing was made yet
                began = time.monotonic()
            continue
        left, done = left - costs[job], done + 1
        if left and _TOLD * len(rows) // len(order) > _TOLD * (len(rows) - 1) // len(order):
            rest = (time.monotonic() - began) * left / (total - left)
            time_left = f"; {lasting(rest)} left" if rest >= 60 else ""
            view.say(f"{len(rows)} of {len(order)} trainings are done{time_left}")
    return [rows[job] for job in costs if job in rows]
