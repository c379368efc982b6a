"""`tacevo show`: what a run found, and everything about one candidate."""

from collections.abc import Mapping
from pathlib import Path

from tacevo.errors import RunError
from tacevo.records import Json
from tacevo.rundir import RunDirectory
from tacevo.summary import summarise, table
from tacevo.unsent import TEMPERATURE, sent_temperature

#: Ledger fields of a candidate that are shown elsewhere, or to nobody.
_HIDDEN = {"kind", "id", "prompt", "previous", "hash", "train_losses", "validation_losses", "repairs"}


def show_run(path: Path) -> str:
    """Write the summary of a run, finished or not.

    Raises:
        RunError: this is no run directory, or it is damaged.
    """
    directory = RunDirectory(path)
    run, lines = directory.read_run(), directory.read_ledger()
    with directory.believed():
        finished = bool(lines) and run["digest"] == lines[-1]["hash"]
        state = f"digest: {run['digest']}" if finished else "Not finished: the command that began it continues it."
        return f"{summarise(run, lines, directory.read_elites(), directory.read_spending())}\n{state}\n"


def show_candidate(path: Path, name: str) -> str:
    """Write down one candidate: what was asked, what became of it, its losses and its source or answer.

    Raises:
        RunError: this is no run directory, or it has no such candidate.
    """
    directory = RunDirectory(path)
    run, lines = directory.read_run(), directory.read_ledger()
    found = [line for line in lines if line.get("id") == name]
    if not found:
        last = next((line["id"] for line in reversed(lines) if "id" in line), "none yet")
        raise RunError(f"{path} has no candidate {name!r}; ids look like g02s03, and the last one is {last}")
    with directory.believed():
        line = found[0]
        parts = [f"# {name} of {run['name']}", f"Instruction: {_instruction(run, line)}", _fields(line)]
        if "repairs" in line:
            reasons = ", ".join(f"{sent['stage']}: {sent['reason']}" for sent in line["repairs"])
            parts.append(f"Answers that were sent back before this one: {len(line['repairs'])} ({reasons})")
        if "validation_losses" in line:
            parts.append(_losses(line))
        return "\n\n".join([*parts, directory.read_kept(name) or "Its file is missing."]).rstrip() + "\n"


def _instruction(run: Mapping[str, Json], line: Mapping[str, Json]) -> str:
    """Give the words that the candidate was asked for with."""
    if line["operator"] == "baseline":
        return "none; this is the task's baseline"
    if line["prompt"] is None:
        return str(run["task"]["crossover"]).strip()
    instruction = run["task"]["instructions"][line["prompt"]]
    return f"{instruction['id']}: {instruction['text'].strip()}"


def _fields(line: Mapping[str, Json]) -> str:
    rows = [[key, _value(value)] for key, value in line.items() if key not in _HIDDEN and value is not None]
    if line[TEMPERATURE] is not None and sent_temperature(line) is None:
        planned = f"not sent: the model refuses it ({_value(line[TEMPERATURE])} was planned)"
        rows = [[key, planned if key == TEMPERATURE else value] for key, value in rows]
    return table(["field", "value"], sorted(rows))


def _value(value: Json) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _losses(line: Mapping[str, Json]) -> str:
    pairs = zip(line["train_losses"], line["validation_losses"], strict=True)
    rows = [[str(epoch), f"{train:.6g}", f"{validation:.6g}"] for epoch, (train, validation) in enumerate(pairs, 1)]
    return table(["epoch", "training loss", "validation loss"], rows)
