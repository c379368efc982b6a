"""The command `tacevo study`, of a run or of the jobs of a sweep."""

import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TypeVar

from rich.console import Console

from analysis.report.collection import outcomes, read_studies
from tacevo.cli.common import DIFFERENT, DONE, comparison, tell
from tacevo.cli.tables import print_table, say
from tacevo.config.compose import compose_elsewhere, compose_study, spread
from tacevo.config.given import check_unchosen, compose_given, gives_networks
from tacevo.config.schema import RunConfig
from tacevo.config.sources import is_elsewhere
from tacevo.config.study import NoiseConfig, StudyConfig
from tacevo.environment import as_typed
from tacevo.errors import ConfigError
from tacevo.parts.registry import is_there
from tacevo.results.run import RecordedRun, read_run
from tacevo.runs.datasets import source_of
from tacevo.runs.progress import Progress
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.studies.given_run import record_given
from tacevo.studies.of_sweep import study_sweep
from tacevo.studies.study import Studied, study
from tacevo.text import as_override, counted, listed

#: What a study on its run's own data is called.
_OWN = "the run's own data"

#: The settings of a study that tests another sensor than it trains on.
_ACROSS = ("data.test_sensor=", "data.shots=")

#: What to do where trainings of a study fail.
_REMEDY = "raise seconds= or memory_mib=, or lower elites="

Configured = TypeVar("Configured", bound=StudyConfig | NoiseConfig)


def _runs(words: Sequence[str]) -> list[str]:
    """Return the bare words, each of which names a run."""
    return [word for word in words if "=" not in word or Path(word).exists()]


def composed(compose: Callable[[Sequence[str]], Configured], words: Sequence[str]) -> Configured:
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


def run_study(words: Sequence[str]) -> int:
    """Study networks."""
    if not _runs(words) and gives_networks(words):
        first, *others = _each_data(words)
        config, run, files = compose_given(first)
        every = _within(run, [[], *others])
        with Progress() as view:
            config = replace(config, run=str(record_given(run, files, view)))
        if len(every) > 1:
            return _study_each(config, every)
        with Progress() as view:
            studied = study(config, view)
    else:
        other = [override for override in words if is_elsewhere(override)]
        config = composed(compose_study, [override for override in words if override not in other])
        if config.sweep is not None:
            with Progress() as view:
                studies, unfinished = study_sweep(Path(config.sweep), config, view, other)
            return report_sweep(Path(config.sweep), studies, unfinished, "study", "raise seconds= or memory_mib=")
        if RunDirectory(Path(config.run or "")).read_run().is_of_given:
            check_unchosen(words)
        if len(each := [*product(*spread(other))] if other else [()]) > 1:
            own = replace(read_run(Path(config.run or ""), config.store.root).with_data, executor=config.executor)
            return _study_each(config, _within(own, each))
        with Progress() as view:
            studied = study(config, view, other)
    introduce(studied, "study")
    show_found(studied, config.store.root)
    return end(studied, "study", _REMEDY)


def _each_data(overrides: Sequence[str]) -> list[list[str]]:
    """Write the settings of given networks on several data sets as those of the first, and what others have instead."""
    several = [word for word in overrides if is_elsewhere(word)]
    each = [list(words) for words in product(*spread(several))]
    first = each[0]
    named = dict(word.split("=", 1) for word in first)
    tested = named.get("data.test_sensor")
    if tested is not None and tested == named.get("data.sensor"):  # which is within that sensor, as of `_within`
        first = [word for word in first if not word.startswith(_ACROSS)]
    usual = [word for word in overrides if word not in several]
    return [[*usual, *first], *([word for word in words if word not in first] for words in each[1:])]


def _within(own: RunConfig, each: Sequence[Sequence[str]]) -> list[list[str]]:
    """Check the settings of several studies, and that their data list such images, before the first of them is trained.

    A sensor that is tested and would train alone is studied within itself, so lists of both give each pair of sensors.
    """
    checked: list[list[str]] = []
    for words in each:
        settings, data = list(words), compose_elsewhere(own, words).data
        if data.test_sensor is not None and data.test_sensor == data.sensor:
            settings = [word for word in words if not word.startswith(_ACROSS)]
            settings += ["data.test_sensor=null"] if own.data.test_sensor is not None else []
            settings += ["data.shots=0"] if own.data.shots else []
        if settings not in checked:
            checked.append(settings)
    for settings in checked if len(checked) > 1 else []:
        source_of(compose_elsewhere(own, settings)).catalogue()
    return checked


def _study_each(config: StudyConfig, each: Sequence[Sequence[str]]) -> int:
    """Study the same networks on each of several data sets, or devices, and set them side by side."""
    from analysis.studies.transfer import sensor_groups, transfers
    from analysis.tables.transfer import sensor_table, transfer_tables

    run = read_run(Path(config.run or ""), config.store.root)
    statuses, done = [], dict[str, Studied]()
    for other in each:
        with Progress() as view:
            studied = study(config, view, other)
        introduce(studied, f"study of {' '.join(other) or _OWN}")
        statuses.append(end(studied, "study", _REMEDY))
        done[studied.directory.name] = studied
    # Of several studies on equal data a table takes the first: let it be the one that was asked for.
    studies = sorted(read_studies(run).studies, key=lambda one: one.name not in done)
    own, told = {id(one.study): one.name for one in studies if one.name in done}, set[str]()
    for group in transfers((one.study, one.comparisons) for one in studies):
        members = {own[id(one)] for one, _ in group if id(one) in own}
        for table in transfer_tables(group) if members else ():
            print_table(table, Console())
        told |= members
    for sensors in sensor_groups((one.study for one in studies), run.config.data):
        if any(id(one.study) in own for one in sensors):
            print_table(sensor_table(sensors), Console())
    for name in [name for name in done if name not in told]:  # nothing can be set beside it
        show_found(done[name], config.store.root)
    if told:
        tell(f"look:   {as_typed('tacevo')} tables {shlex.quote(str(run.path))}")
    return max(statuses)


def report_sweep(sweep: Path, studies: Sequence[Studied], unfinished: Sequence[str], what: str, remedy: str) -> int:
    """Print the studies of the jobs of a sweep, and which jobs have none; return the exit status."""
    statuses = []
    for one in studies:
        introduce(one, what)
        statuses.append(end(one, what, remedy, in_sweep=True))
    for job in unfinished:
        tell(f"no {what}, for it is not finished: {job}")
    tell(f"next:   {comparison(sweep)}")
    return DIFFERENT if unfinished else max(statuses)


def introduce(studied: Studied, what: str) -> None:
    """Print where a study, or what it is called, lies, and how much of it was trained now; before it, its choice."""
    if studied.choice is not None:
        introduce(studied.choice, "choice")
    before = f", {studied.recorded} of them recorded already" if studied.recorded else ""
    twice = f", {studied.twice} of them made twice, as above" if studied.twice else ""
    tell(f"{what}: {studied.directory} ({counted(studied.trainings, 'training')}{before}{twice})")


def show_found(studied: Studied, store: str | None) -> RecordedRun:
    """Print what was found in short, and where all of it is to be seen; return the run."""
    run = read_run(studied.directory.parents[1], store)
    studies = read_studies(run)
    if table := outcomes(run, studies).get(studied.directory.name):
        print_table(table, Console())
        say(why for why in studies.left_out + studies.remarks if studied.directory.name in why)
    for command in ("tables", *(("report",) if is_there("analysis.report.page") else ())):
        tell(f"look:   {as_typed('tacevo')} {command} {shlex.quote(str(run.path))}")
    return run


def end(studied: Studied, what: str, remedy: str, *, in_sweep: bool = False) -> int:
    """Print which trainings failed, and the digests; return the exit status. `what` it is called in messages."""
    for row in studied.failed:
        tell(f"failed: {row}")
    if studied.failed:
        tell(f"no statistics without these: {remedy}")
    run = RunDirectory(studied.directory.parents[1]).read_run()
    cited = "of this job; `tacevo publish` gives the sweep's, the one to cite" if in_sweep else "the one to cite"
    tell(f"run digest: {run.digest} ({cited}; the digest below is that of the {what})")
    tell(f"digest: {studied.digest}")
    return DIFFERENT if studied.failed else DONE
