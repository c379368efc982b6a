"""Networks that a user gives, past the gate: for the first generation of a search, or for a study of them."""

import ast
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tacevo.config.schema import RunConfig
from tacevo.data.dataset import Dataset
from tacevo.errors import ConfigError
from tacevo.gate.admission import Gate
from tacevo.gate.extraction import as_whole
from tacevo.gate.policy.problems import Problem, parse
from tacevo.records import Completion, Given, Mode, Rejection, Task
from tacevo.rules import CURRENT
from tacevo.runs.wiring import Workbench


def admitted_networks(
    config: RunConfig, task: Task, data: Dataset, files: Mapping[Path, Given], place: str = "networks"
) -> tuple[Given, ...]:
    """Put files of networks through the gate, all of them before the first is trained; the run recalls the verdicts.

    `place` is the setting that names the files.

    Raises:
        ConfigError: the gate rejects a file, or would take a part of it only, or two of them are one network.
    """
    with Workbench(config, task, data.facts, Mode.record, data=data) as bench:
        gate = bench.gate(CURRENT)
        given = tuple(bench.executor.map(lambda path: _admitted(gate, path, files[path], place), files))
    _check_different(task, given, place)
    return given


def _admitted(gate: Gate, path: Path, network: Given, place: str) -> Given:
    """Put a file through the gate, as if a model had answered with it."""
    answer = Completion(text=network.source, model="", stop_reason="end_turn", input_tokens=0, output_tokens=0)
    verdict = gate.admit(answer)
    if isinstance(verdict, Rejection):
        raise ConfigError(
            f"one that is rejected: {verdict.stage}, {verdict.reason}: {verdict.detail}",
            place=f"{place}, {path}",
            expected="a network that the gate admits",
        )
    changes = gate.notes(answer)
    if changes:
        raise ConfigError(
            f"one that the gate would change: {'; '.join(changes)}",
            place=f"{place}, {path}",
            expected="a network that the gate takes as it is",
            remedy="change it so yourself",
        )
    if verdict.source != as_whole(network.source):
        raise ConfigError(
            "text of which the gate would take a part, as from a model's answer",
            place=f"{place}, {path}",
            expected="Python as a whole",
            remedy="correct the file: a syntax error, text beside the code or marks of a merge may stand in it",
        )
    return replace(network, source=verdict.source)


def _check_different(task: Task, given: Sequence[Given], place: str = "networks") -> None:
    """Refuse a network that is there twice: its seeds would be counted twice."""
    known = {_tree(task.baseline): "baseline"}
    for network in given:
        other = known.setdefault(_tree(network.source), network.name)
        if other != network.name:
            expected = "different networks"
            raise ConfigError(f"{other} and {network.name} are one", place=place, expected=expected)


def _tree(source: str) -> str:
    """Write a source as its syntax tree, which is the same whatever its comments and layout are."""
    tree = parse(source)
    if isinstance(tree, Problem):  # a baseline, which the run's gate then refuses
        return source
    try:
        return ast.dump(tree)
    except RecursionError:
        return source
