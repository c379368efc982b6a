"""What a network of a search changed: the instructions that led to it, and the layers that its code has."""

import ast
from collections import Counter

from tacevo.evolution.lines import CandidateLine
from tacevo.records import Operator
from tacevo.results.run import RecordedRun
from tacevo.text import on_a_line, parse_python


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


def layer_changes(before: str, after: str) -> tuple[list[str], list[str]]:
    """Compare two sources by the layers that they make, as `nn.Dropout(0.4)`: what a model did, whatever it was asked.

    A layer is the call of a name that begins with a capital, without others in it: an `nn.Sequential` is what it holds.

    Returns:
        The layers that only the second source has, and those that only the first one has, in their order; one that is
        there several times more has their number, as `nn.GELU() (4)`. Two empty lists where one cannot be read.
    """
    try:
        ours, theirs = _layers(before), _layers(after)
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # of another Python, or too deep for its parser
        return [], []
    return _counted(theirs - ours), _counted(ours - theirs)


def _layers(source: str) -> Counter[str]:
    calls = [node for node in ast.walk(parse_python(source)) if isinstance(node, ast.Call) and _is_layer(node)]
    holding = {
        id(call)
        for call in calls
        for node in ast.walk(call)
        if node is not call and isinstance(node, ast.Call)
        if _is_layer(node)
    }
    calls.sort(key=lambda call: (call.lineno, call.col_offset))
    return Counter(ast.unparse(call) for call in calls if id(call) not in holding)


def _is_layer(call: ast.Call) -> bool:
    named = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    return named[:1].isupper()


def _counted(layers: Counter[str]) -> list[str]:
    return [on_a_line(layer) + (f" ({count})" if count > 1 else "") for layer, count in layers.items()]
