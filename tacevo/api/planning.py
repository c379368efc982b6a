"""The number of seeds that a study or a sweep needs, by its pilots."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from analysis.sweeps.pilots import study_pilot, sweep_pilot
from analysis.sweeps.plans import Planned, Wish
from analysis.sweeps.plans import plan as weigh
from analysis.tables.plan import plan_table
from tacevo.api.runs import Run
from tacevo.api.studies import Study
from tacevo.api.sweeps import Sweep
from tacevo.api.tables import Table
from tacevo.bundles.open import opened
from tacevo.errors import ConfigError, RunError
from tacevo.results.run import RecordedRun, read_run
from tacevo.results.study import RecordedStudy, load_study
from tacevo.results.study_directory import studies_of
from tacevo.results.sweep import load_sweep
from tacevo.storage.files import write_durably
from tacevo.storage.plan_file import SeedPlan, plan_text, signed_plan
from tacevo.storage.signatures import checked_key
from tacevo.storage.sweep_directory import SweepDirectory

#: The types that a pilot can be read from.
PilotSource = Run | Study | Sweep | str | os.PathLike[str]


def plan(
    kind: Literal["study", "sweep"],
    *pilots: PilotSource,
    effect: float,
    comparisons: int | None = None,
    power: float = 0.8,
    alpha: float = 0.05,
    output: str | os.PathLike[str] | None = None,
    sign: str | os.PathLike[str] | None = None,
) -> Table:
    """Compute how many seeds are needed to detect an effect after Holm's correction, and the cost, in all ways.

    Args:
        kind: what is planned: `study`, training seeds of each network, or `sweep`, jobs of each arm.
        pilots: for a study, finished studies, all those of runs, or the directories of either; for a sweep, sweeps.
        effect: what is to be found, in (0, 1): a part of an error (0.1 is 10 % less), or a difference of an accuracy.
        comparisons: variants, or arms beside the reference; as many as the pilot has if None.
        power: wished chance of finding it, in (0, 1).
        alpha: level of the tests, in (0, 1).
        output: the directory to write plan.json into, for `plan=` of a study and `--plan` of a sweep; nothing is
            written where no number of seeds that is tried suffices.
        sign: the file of an SSH key, with which plan.json is signed.

    Returns:
        A row a way; `plan` says `chosen` of the cheapest, unless no number of seeds that is tried suffices.

    Raises:
        ConfigError: a number is out of its range, or the kind is another; or there is no such key, or nothing to sign.
        RunError: a pilot has no finished study, is not a sweep, or cannot be planned from.
    """
    if kind not in ("study", "sweep"):
        raise ConfigError(repr(kind), place="kind", expected="'study' or 'sweep'")
    for name, value in {"effect": effect, "power": power, "alpha": alpha}.items():
        if not 0 < value < 1:
            raise ConfigError(str(value), place=name, expected="a number between 0 and 1")
    if comparisons is not None and comparisons < 1:
        raise ConfigError(str(comparisons), place="comparisons", expected="an integer of at least 1")
    key = None if sign is None else checked_key(Path(sign))
    if key is not None and output is None:
        raise ConfigError("none", place="output", expected="the directory of plan.json, which sign= signs")
    planned = planned_from(kind, pilots, effect=effect, comparisons=comparisons, power=power, alpha=alpha)
    if output is not None and planned.plan is not None:
        write_plan(planned.plan, Path(output), key)
    return Table(plan_table(planned))


def planned_from(
    kind: Literal["study", "sweep"],
    pilots: Sequence[PilotSource],
    *,
    effect: float,
    comparisons: int | None,
    power: float,
    alpha: float,
) -> Planned:
    """Return all ways, and the plan; arguments as of `plan`, within their ranges."""
    if kind == "study":
        pilot = study_pilot([pair for one in pilots for pair in _finished_studies(one)])
    else:
        pilot = sweep_pilot([load_sweep(_sweep(one)) for one in pilots])
    return weigh(pilot, Wish(effect=effect, alpha=alpha, power=power, comparisons=comparisons or pilot.comparisons))


def write_plan(plan: SeedPlan, directory: Path, key: Path | None = None) -> SeedPlan:
    """Write plan.json into a directory; return the plan with its day, signed by the key of a file if there is one.

    Raises:
        ConfigError: as `tacevo.storage.signatures.sign`.
    """
    made = replace(plan, made=datetime.now(UTC).date().isoformat())
    if key is not None:
        made = signed_plan(made, key)
    directory.mkdir(parents=True, exist_ok=True)
    write_durably(directory / "plan.json", plan_text(made))
    return made


def _sweep(pilot: PilotSource) -> Path:
    """Return the directory of a sweep, which need not be finished, or of a bundle's."""
    if isinstance(pilot, Run | Study):
        got = "a run" if isinstance(pilot, Run) else "a study"
        raise RunError(got, place=pilot.name, expected="the directory or bundle of a sweep")
    if isinstance(pilot, Sweep):
        return pilot.place.folder
    path = Path(pilot)
    folder = path if path.is_dir() else opened(path).folder
    if not SweepDirectory(folder).is_one:
        got = "a directory without sweep.json" if path.is_dir() else "the bundle of a run"
        raise RunError(got, place=str(path), expected="the directory or bundle of a sweep")
    return folder


def _finished_studies(pilot: PilotSource) -> Iterator[tuple[RecordedRun, RecordedStudy]]:
    """Read the finished studies of a pilot, each with its run."""
    if isinstance(pilot, Study):
        yield pilot.recorded_run, pilot.recorded
        return
    if isinstance(pilot, Run | Sweep):
        name = str(pilot.place.folder)
        runs = [pilot.recorded] if isinstance(pilot, Run) else [run.recorded for run in pilot.runs]
    elif (Path(pilot) / "study.json").exists():
        yield read_run(Path(pilot).resolve().parents[1]), load_study(Path(pilot))
        return
    else:
        name, runs = str(pilot), [read_run(folder) for folder in opened(Path(pilot)).runs]
    number = 0
    for run in runs:
        for directory in studies_of(run.path):
            record = directory.read()
            if record.terms is not None and record.digest is not None:
                number += 1
                yield run, load_study(directory.path)
    if not number:
        remedy = f"`tacevo study {shlex.quote(name)}` makes one; a few seeds will do for a pilot"
        raise RunError("none", place=name, expected="at least one finished study", remedy=remedy)
