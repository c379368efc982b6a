"""The commands `tacevo study`, of a run or of the jobs of a sweep, `tacevo noise`, and `tacevo plan` before both."""

import argparse
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import TypeVar

from rich.console import Console

from analysis.report.collection import outcomes, read_studies
from analysis.studies.transfer import transfers
from analysis.sweeps.pilots import Pilot, study_pilot, sweep_pilot
from analysis.sweeps.plans import Wish, plan
from analysis.tables.plan import plan_table
from analysis.tables.transfer import transfer_tables
from tacevo.bundles.open import opened
from tacevo.cli.common import DIFFERENT, DONE, output_directory
from tacevo.cli.tables import print_table, say
from tacevo.config.compose import compose_data, compose_noise, compose_study, spread
from tacevo.config.given import check_unchosen, compose_given, gives_networks
from tacevo.config.study import NoiseConfig, StudyConfig
from tacevo.environment import as_typed
from tacevo.errors import ConfigError, RunError
from tacevo.results.run import RecordedRun, read_run
from tacevo.results.study import RecordedStudy, load_study
from tacevo.results.study_directory import StudyDirectory, studies_of
from tacevo.results.sweep import load_sweep
from tacevo.runs.progress import Progress
from tacevo.storage.files import write_durably
from tacevo.storage.plan_file import plan_text
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.studies.given_run import record_given
from tacevo.studies.of_sweep import estimate_noise_of_sweep, study_sweep
from tacevo.studies.study import Studied, estimate_noise, study
from tacevo.text import as_override, counted, listed

#: What to do where trainings of a study fail.
_REMEDY = "raise seconds= or memory_mib=, or lower elites="

Configured = TypeVar("Configured", bound=StudyConfig | NoiseConfig)


def _runs(words: Sequence[str]) -> list[str]:
    """Return the bare words, each of which names a run."""
    return [word for word in words if "=" not in word or Path(word).exists()]


def _composed(compose: Callable[[Sequence[str]], Configured], words: Sequence[str]) -> Configured:
    """Compose the settings of a command, one of which, the run, may be given as a bare word.

    Raises:
        ConfigError: as `compose`, or two runs or a sweep are named.
    """
    runs = _runs(words)
    settings = [word for word in words if word not in runs]
    if not runs:
        config = compose(settings)
    else:
        others = [setting for setting in settings if setting.startswith(("run=", "sweep=", "networks="))]
        if named := [*runs[1:], *others]:
            raise ConfigError(listed([runs[0], *named]), place="run", expected="one run, as RUN or run=RUN")
        config = replace(compose([*settings, "run=RUN"]), run=runs[0])
    if config.run is not None and SweepDirectory(Path(config.run)).is_one:
        every = shlex.quote(as_override("sweep", config.run))
        remedy = f"name the run of a job, {config.run}/JOB; {every} takes all jobs"
        raise ConfigError(f"the sweep {config.run}", place="run", expected="the directory of one run", remedy=remedy)
    return config


def run_study(options: argparse.Namespace) -> int:
    """Study networks."""
    if not _runs(options.overrides) and gives_networks(options.overrides):
        config, run, files = compose_given(options.overrides)
        with Progress() as view:
            studied = study(replace(config, run=str(record_given(run, files, view))), view)
    else:
        data = [override for override in options.overrides if override.startswith(("data=", "data."))]
        config = _composed(compose_study, [override for override in options.overrides if override not in data])
        if config.sweep is not None:
            if data:
                expected = "no setting of data with sweep=: jobs are compared on their own data"
                raise ConfigError(data[0], place="study", expected=expected)
            return _study_sweep(Path(config.sweep), config)
        if RunDirectory(Path(config.run or "")).read_run().task.given:
            check_unchosen(options.overrides)
        if len(elsewhere := [*product(*spread(data))] if data else [()]) > 1:
            return _study_each(config, elsewhere)
        with Progress() as view:
            studied = study(config, view, data)
    _introduce(studied, "study")
    _show(studied, config.store.root)
    return _end(studied, _REMEDY)


def _study_each(config: StudyConfig, elsewhere: Sequence[Sequence[str]]) -> int:
    """Study the same networks on each of several data sets, one after the other, and set them side by side."""
    run = read_run(Path(config.run or ""), config.store.root)
    for data in elsewhere:  # before the first is trained
        compose_data(run.config, data)
    statuses, names = [], set()
    for data in elsewhere:
        with Progress() as view:
            studied = study(config, view, data)
        _introduce(studied, f"study of {' '.join(data)}")
        statuses.append(_end(studied, _REMEDY))
        names.add(studied.directory.name)
    studies = read_studies(run).studies
    own = [one.study for one in studies if one.name in names]
    for group in transfers((one.study, one.comparisons) for one in studies):
        if any(one is study for one, _ in group for study in own):
            for table in transfer_tables(group):
                print_table(table, Console())
    print(f"look:   {as_typed('tacevo')} tables {shlex.quote(str(run.path))}")
    return max(statuses)


def _study_sweep(sweep: Path, config: StudyConfig) -> int:
    with Progress() as view:
        studies, unfinished = study_sweep(sweep, config, view)
    return _report_sweep(sweep, studies, unfinished, "study", "raise seconds= or memory_mib=")


def _noise_sweep(sweep: Path, config: NoiseConfig) -> int:
    with Progress() as view:
        noise_runs, unfinished = estimate_noise_of_sweep(sweep, config, view)
    return _report_sweep(sweep, noise_runs, unfinished, "noise run", "lower elites=")


def _report_sweep(sweep: Path, studies: Sequence[Studied], unfinished: Sequence[str], what: str, remedy: str) -> int:
    statuses = []
    for one in studies:
        _introduce(one, what)
        statuses.append(_end(one, remedy))
    for job in unfinished:
        print(f"no {what}, for it is not finished: {job}")
    print(f"next:   {as_typed('tacevo')} ablations {shlex.quote(str(sweep))}")
    return DIFFERENT if unfinished else max(statuses)


def run_noise(options: argparse.Namespace) -> int:
    """Train elites again under other seeds."""
    config = _composed(compose_noise, options.overrides)
    if config.sweep is not None:
        return _noise_sweep(Path(config.sweep), config)
    with Progress() as view:
        studied = estimate_noise(config, view)
    _introduce(studied, "noise run")
    run = _show(studied, config.store.root)
    if run.answered and not run.shortfall:
        usual = compose_study(["run=RUN"])
        elites = min(len(StudyDirectory(studied.directory).read().networks) - 1, usual.elites)
        trainings = f"{counted((elites + 1) * usual.seeds, 'training')} of {counted(usual.epochs, 'epoch')}"
        command = f"{as_typed('tacevo')} study {shlex.quote(str(run.path))} choose=reestimated elites={elites}"
        print(f"next:   {command}    # {trainings}")
    return _end(studied, "lower elites=")


def _introduce(studied: Studied, what: str) -> None:
    before = f", {studied.recorded} of them recorded already" if studied.recorded else ""
    print(f"{what}: {studied.directory} ({counted(studied.trainings, 'training')}{before})")


def _show(studied: Studied, store: str | None) -> RecordedRun:
    """Print what was found in short, and where all of it is to be seen; return the run."""
    run = read_run(studied.directory.parents[1], store)
    studies = read_studies(run)
    if table := outcomes(run, studies).get(studied.directory.name):
        print_table(table, Console())
        say(why for why in studies.left_out if studied.directory.name in why)
    for command in ("tables", "report"):
        print(f"look:   {as_typed('tacevo')} {command} {shlex.quote(str(run.path))}")
    return run


def _end(studied: Studied, remedy: str) -> int:
    """Print which trainings failed, and the digest; return the exit status."""
    for row in studied.failed:
        print(f"failed: {row}")
    if studied.failed:
        print(f"no statistics without these: {remedy}")
    print(f"digest: {studied.digest}")
    return DIFFERENT if studied.failed else DONE


def run_plan(options: argparse.Namespace) -> int:
    """Plan a number of seeds."""
    pilot = _pilot(options.kind, [Path(name) for name in options.runs])
    wish = Wish(
        effect=options.effect,
        alpha=options.alpha,
        power=options.power,
        comparisons=options.comparisons or pilot.comparisons,
    )
    planned = plan(pilot, wish)
    directory = output_directory(options.output)
    print_table(plan_table(planned), Console())
    if planned.plan is None:
        (directory / "plan.json").unlink(missing_ok=True)  # else a study would follow another wish than the last
        print("no plan: wish for a larger effect or a lower power, or compare fewer")
        return DIFFERENT
    made = replace(planned.plan, made=datetime.now(UTC).date().isoformat())
    write_durably(directory / "plan.json", plan_text(made))
    print(f"plan: {directory / 'plan.json'}, {made.dated}")
    return DONE


def _pilot(kind: str, paths: Sequence[Path]) -> Pilot:
    if kind == "study":
        return study_pilot([pair for path in paths for pair in _finished_studies(path)])
    return sweep_pilot([load_sweep(_located_sweep(path)) for path in paths])


def _located_sweep(path: Path) -> Path:
    """Return the directory of a sweep, which need not be finished, or of a bundle's."""
    folder = path if path.is_dir() else opened(path).folder
    if not SweepDirectory(folder).is_one:
        got = "a directory without sweep.json" if path.is_dir() else "the bundle of a run"
        raise RunError(got, place=str(path), expected="the directory or bundle of a sweep")
    return folder


def _finished_studies(path: Path) -> Iterator[tuple[RecordedRun, RecordedStudy]]:
    """Read the finished studies of a pilot, each with its run."""
    if (path / "study.json").exists():
        yield read_run(path.resolve().parents[1]), load_study(path)
        return
    number = 0
    for folder in opened(path).runs:
        run = read_run(folder)
        for directory in studies_of(folder):
            record = directory.read()
            if record.terms is not None and record.digest is not None:
                number += 1
                yield run, load_study(directory.path)
    if not number:
        remedy = f"`tacevo study {shlex.quote(str(path))}` makes one; a few seeds will do for a pilot"
        raise RunError("none", place=str(path), expected="at least one finished study", remedy=remedy)
