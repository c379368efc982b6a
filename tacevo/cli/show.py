"""The command `tacevo show`: a run, one candidate of it, or how far the jobs of a sweep are."""

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import fill

from analysis.report.collection import outcomes, read_studies
from analysis.tables.rendering import as_text
from tacevo.bundles.open import opened
from tacevo.cli.common import DONE, TO_CITE, tell, tell_markdown
from tacevo.config.recorded_parts import own_axes
from tacevo.config.schema import RunConfig
from tacevo.errors import ConfigError, RunError
from tacevo.evolution.lines import TEMPERATURE, CandidateLine, why_not_sent
from tacevo.evolution.prompts import SAMPLING
from tacevo.evolution.run_files import Line, check_references, read_elites, read_ledger
from tacevo.gate.imports import with_imports
from tacevo.records import Json, Operator, Task, written
from tacevo.results.run import RecordedRun, finished_run
from tacevo.results.settings import read_config
from tacevo.results.study_directory import studies_of
from tacevo.results.summary import summarise
from tacevo.storage.ledger import Sealed
from tacevo.storage.notes import HEADING, read_note
from tacevo.storage.run_directory import RunDirectory, RunRecord
from tacevo.storage.sweep_directory import UNSTATED, SweepDirectory
from tacevo.sweeps.status import describe_jobs, status_of
from tacevo.sweeps.terms import describe_terms
from tacevo.text import on_a_line, plain, printable, table


def run_show(run: str, candidate: str | None, *, only_source: bool) -> int:
    """Print a run, a candidate of it or only its source, or the jobs of a sweep."""
    path, store = Path(run), None
    if not path.is_dir():
        bundle = opened(path)
        path, store = bundle.folder, bundle.store
    if (sweep := SweepDirectory(path)).is_one:
        if candidate is not None:
            expected = f"no second name after a sweep; a job of it is named {run}/JOB"
            raise ConfigError(candidate, place="tacevo show", expected=expected)
        text = show_sweep(sweep)
    elif candidate is not None:
        text = source_of(path, candidate) if only_source else show_candidate(path, candidate)
    else:
        text = show_run(path, store)
    if candidate is None:
        tell_markdown(text)
    else:  # a source stays as it is
        tell(text, end="")
    return DONE


def show_sweep(directory: SweepDirectory) -> str:
    """List every job of a sweep: finished, running, failed and why, stopped, not begun; its terms; its makers' note.

    Raises:
        RunError: sweep.json is damaged.
    """
    record = directory.read()
    jobs = describe_jobs([status_of(directory, job) for job in record.jobs])
    over = f" over {shlex.join(record.overrides)}" if record.overrides else ""  # a published sweep has none
    terms = [] if record.terms == UNSTATED else [f"{describe_terms(record.terms)}\n"]
    return "\n".join([f"sweep{over}: {jobs}\n", *terms, *_note(directory.path)])


#: Stands above a source whose hash is not the ledger's.
_EDITED = "EDITED: this is not the source that the run admitted. Its hash is not the ledger's."

#: Ledger fields of a candidate that are shown elsewhere, or not at all.
_HIDDEN = {"kind", "id", "prompt", "train_losses", "validation_losses", "repairs", "measures"}


def show_run(path: Path, store: Path | None = None) -> str:
    """Write the summary of a run, finished or not, then what its studies and noise runs found, then its makers' note.

    `store` are the entries of its bundle.

    Raises:
        RunError: this is not a run directory, or it is damaged.
    """
    directory, run, ledger = _read_begun(path)
    finished = run.digest == ledger.digest
    if finished:
        state = f"cite:   {TO_CITE.format('search')}\ndigest: {run.digest}"
        known = replace(finished_run(directory, run, ledger), packed=store)
    else:
        state = "Not finished: the command that began it continues it."
        config, elites = read_config(path, run), read_elites(directory)
        known = RecordedRun(directory=directory, record=run, config=config, ledger=ledger, elites=elites)
    trained = {line.id for line in ledger.lines if isinstance(line, CandidateLine) and line.fitness is not None}
    if unknown := sorted({elite.id for elite in known.elites} - trained):
        expected = "trained candidates of the ledger"
        raise RunError(unknown[0], place=f"{path}/archive.json", expected=expected, remedy="restore the file")
    note = "".join(f"{one}\n" for one in _note(path))
    return f"{_on_screen(summarise(known))}\n{_studied(known) if finished else ''}{note}{state}\n"


def _note(path: Path) -> list[str]:
    """Write the note of a run's or a sweep's makers; nothing where there is none."""
    paragraphs = read_note(path)
    return ["\n\n".join([HEADING, *map(_quoted, paragraphs)]) + "\n"] if paragraphs else []


def _on_screen(summary: str) -> str:
    """Return summary.md without the marks of Markdown, but for its headings and tables, which are read as they are."""
    lines = summary.split("\n")
    return "\n".join(line if line.startswith(("#", "|")) else on_a_line(plain(line)) for line in lines)


def _quoted(paragraph: str) -> str:
    """Write a paragraph of a note as a quotation, which no line of the summary is."""
    return fill(printable(plain(paragraph)), 110, initial_indent="> ", subsequent_indent="> ")


def _read_begun(path: Path) -> tuple[RunDirectory, RunRecord, Sealed[Line]]:
    """Read a run, finished or not, and its ledger, which is begun before run.json is written."""
    directory = RunDirectory(path)
    run, ledger = directory.read_run(), read_ledger(directory)
    if not ledger.lines:
        raise RunError("nothing", place=str(directory.ledger), expected="the run's ledger", remedy="restore the file")
    check_references(path, run, ledger.lines)
    return directory, run, ledger


def _studied(run: RecordedRun) -> str:
    """Write what the studies and noise runs of a finished run found; nothing without any."""
    if not studies_of(run.path):
        return ""
    studies = read_studies(run)
    parts = [f"## {on_a_line(name)}\n\n{as_text(table)}" for name, table in outcomes(run, studies).items()]
    return "".join(
        f"{part}\n" for part in [*parts, *(f"left out: {why}\n" for why in studies.left_out + studies.remarks)]
    )


def show_candidate(path: Path, name: str) -> str:
    """Write down one candidate: what was asked, what became of it, its losses and its source or answer.

    Raises:
        RunError: this is not a run directory, or it has no such candidate.
    """
    directory, run, ledger = _read_begun(path)
    line = _candidate(path, ledger, name)
    config = read_config(path, run)
    parts = [f"# {name} of {run.name}", f"Instruction: {_instruction(run.task, line)}", _fields(line, config)]
    if line.repairs:
        reasons = ", ".join(f"{sent.stage}: {sent.reason}" for sent in line.repairs)
        parts.append(f"Answers that were sent back before this one: {len(line.repairs)} ({reasons})")
    if line.train_losses is not None and line.validation_losses is not None:
        parts.append(_losses(line.train_losses, line.validation_losses))
    return "\n\n".join([*parts, *_kept(directory, line)]).rstrip() + "\n"


def source_of(path: Path, name: str) -> str:
    """Return the source of one candidate as a file that runs, with the imports that it was given.

    Raises:
        RunError: as `show_candidate`; or the gate rejected it, or its file was edited.
    """
    directory, _, ledger = _read_begun(path)
    line = _candidate(path, ledger, name)
    if line.source is None:
        raise RunError(f"{name}, which the gate rejected", place=str(path), expected="an admitted candidate")
    return with_imports(directory.read_source(line.id, line.source))


def _candidate(path: Path, ledger: Sealed[Line], name: str) -> CandidateLine:
    lines = {line.id: line for line in ledger.lines if isinstance(line, CandidateLine)}
    if name not in lines:
        last = next(reversed(lines), "none yet")
        expected = f"the id of a candidate, such as g02s03; the last one is {last}"
        raise RunError(repr(name), place=str(path), expected=expected)
    return lines[name]


def _kept(directory: RunDirectory, line: CandidateLine) -> list[str]:
    """Return the source or the answer of a candidate as its file has it, below what is wrong with it."""
    kept, is_edited = directory.read_checked(line.id, line.source)
    if kept is None:
        return ["Its file is missing."]
    return [*([_EDITED] if is_edited else []), kept.decode(errors="replace")]


def _instruction(task: Task, line: CandidateLine) -> str:
    """Return the instruction that the candidate was asked for with."""
    if line.operator is Operator.baseline:
        return "none; this is the task's baseline"
    if line.operator is Operator.sample:
        return SAMPLING
    if line.operator is Operator.given:
        return f"none; this network was given, as {task.given[line.slot - 1].name}"
    if line.prompt is None:
        return task.crossover.strip()
    instruction = task.instructions[line.prompt]
    return f"{instruction.id}: {instruction.text.strip()}"


def _fields(line: CandidateLine, config: RunConfig) -> str:
    """Write the fields of a candidate's line."""
    axes = own_axes(config)
    fields = {key: value for key, value in written(line).items() if key not in _HIDDEN} | dict(
        zip(axes, line.measures, strict=False)
    )
    rows = [[key, _value(value)] for key, value in fields.items() if value is not None]
    if line.temperature is not None and line.sent_temperature is None:
        refused = why_not_sent(TEMPERATURE, thinks=config.llm.thinks)
        why = refused if TEMPERATURE in line.dropped else f"temperature.carrier={line.carrier}"
        planned = f"not sent: {why} ({_value(line.temperature)} was planned)"
        rows = [[key, planned if key == TEMPERATURE else value] for key, value in rows]
    return table(["field", "value"], sorted(rows))


def _value(value: Json) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _losses(train: Sequence[float], validation: Sequence[float]) -> str:
    pairs = enumerate(zip(train, validation, strict=True), 1)
    rows = [[str(epoch), f"{of_train:.6g}", f"{of_validation:.6g}"] for epoch, (of_train, of_validation) in pairs]
    return table(["epoch", "training loss", "validation loss"], rows)
