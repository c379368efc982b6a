"""What a network of a search changed, by the instructions that it and its ancestors were asked for with."""

from tacevo.evolution.lines import CandidateLine
from tacevo.records import Operator
from tacevo.results.run import RecordedRun
from tacevo.text import on_a_line


def changes(run: RecordedRun, name: str) -> list[str]:
    """List the steps from the baseline to a candidate, oldest first, as `Exchange each ReLU for a GELU (g01s03)`.

    Of a crossover the way is that of its first parent. An instruction says what was asked for, not what a model did.
    """
    lines = {line.id: line for line in run.candidates}
    steps = []
    line = lines.get(name)
    while line is not None and line.parents:
        steps.append(f"{_asked(run, line)} ({line.id})")
        line = lines.get(line.parents[0])
    return steps[::-1]


def _asked(run: RecordedRun, line: CandidateLine) -> str:
    if line.operator is Operator.crossover or line.prompt is None:
        return f"crossed with {line.parents[-1]}"
    return on_a_line(run.record.task.instructions[line.prompt].text).rstrip(".")
