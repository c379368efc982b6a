"""The commands `tacevo study`, of a run or of the jobs of a sweep, `tacevo noise`, and `tacevo plan` before both."""

import argparse
import contextlib
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

from rich.console import Console

from analysis.report.collection import outcomes, read_studies
from analysis.sweeps.ablation import ALPHA
from analysis.sweeps.pilots import Pilot, study_pilot, sweep_pilot
from analysis.sweeps.plans import Wish, plan
from analysis.tables.plan import plan_table
from tacevo.bundles.open import opened
from tacevo.cli.common import DIFFERENT, DONE, Parser, output_directory, whole_number
from tacevo.cli.tables import print_table, say
from tacevo.config.compose import compose_noise, compose_study
from tacevo.config.given import check_unchosen, compose_given, gives_networks
from tacevo.config.study import NoiseConfig, StudyConfig
from tacevo.environment import as_typed
from tacevo.errors import ConfigError, RunError
from tacevo.results.run import RecordedRun, read_run
from tacevo.results.study import RecordedStudy, load_study
from tacevo.results.study_directory import studies_of
from tacevo.results.sweep import load_sweep
from tacevo.runs.progress import Progress
from tacevo.storage.files import write_durably
from tacevo.storage.plan import plan_text
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.studies.given import record_given
from tacevo.studies.of_sweep import estimate_noise_of_sweep, study_sweep
from tacevo.studies.study import Studied, estimate_noise, study
from tacevo.text import as_override, counted, listed

Configured = TypeVar("Configured", bound=StudyConfig | NoiseConfig)

#: What may be set, and what it means; conf/study.yaml has the defaults.
SETTINGS = {
    "run": "the directory of a finished run, whose networks are studied, and may stand alone: RUN; or",
    "sweep": "that of a sweep: a study of each finished job, with its best elite; or",
    "networks": "files of networks, directories and patterns of such; none for the baseline of task= alone",
    "elites": "how many elites of run=, best first, beside the baseline (4)",
    "choose": "best by: fitness (recorded), or reestimated (by `tacevo noise`); the first unless set",
    "seeds": "training seeds of each network (20)",
    "epochs": "of each training; the weights of the best validation epoch are tested (50)",
    "seconds": "the longest time of one training (86400)",
    "memory_mib": "the most memory of one training (4096)",
    "alpha": "level of the tests, after Holm (0.05)",
    "margins.regression.value": "the largest difference of the test MSE that counts as none (0.1)",
    "margins.regression.kind": "relative (to the baseline's median), or absolute; the first unless set",
    "margins.classification.value": "the same for the test accuracy (0.01)",
    "margins.classification.kind": "absolute (in the metric itself), or relative; the first unless set",
    "plan": "the plan.json that it follows, which is kept in it (none)",
    "executor": "local or ray: on this machine, or on the nodes of a Ray cluster; the first unless set",
    "executor.workers": "trainings at once (2)",
    "executor.per_gpu": "with a GPU: most trainings on it at once (1)",
    "executor.address": "of that cluster, as HOST:PORT or auto; none starts a Ray here",
    "store.root": "the directory of the stores (that of the run)",
}

#: The same of a noise run; conf/noise.yaml has the defaults.
NOISE_SETTINGS = {
    "run": "the directory of a finished run, which may stand alone: RUN; or",
    "sweep": "that of a sweep: a noise run of each finished job",
    "elites": "how many elites, best validation loss first, beside the baseline (all)",
    "seeds": "training seeds of each network (5)",
    **{key: SETTINGS[key] for key in ("executor", "executor.workers", "executor.per_gpu", "executor.address")},
    "store.root": SETTINGS["store.root"],
}

_EPILOG = """\
examples:
  tacevo study run=runs/NAME
  tacevo study run=runs/NAME elites=2 seeds=5 epochs=10 executor.workers=8
  tacevo study run=runs/NAME margins.regression.value=0.05
  tacevo study run=runs/NAME data.split_seed=7        # the same networks on other data: any setting of data
  tacevo study sweep=sweeps/NAME seeds=5              # for `tacevo ablations`, which compares arms by these test scores
  tacevo study networks=library/force/published task=force data.image_size=64
  tacevo study networks=[a.py,b.py] task=grating data=tacverse data.root=DIR
  tacevo study task=hardness                          # the baseline alone

Beside networks= and task=, settings of `tacevo search` hold for the run that the networks are recorded in: task, data,
training, numerics, gate, sandbox, seed, experiment, tracking and run.dir.

"""

_NOISE_EPILOG = """\
examples:
  tacevo noise runs/NAME
  tacevo noise runs/NAME elites=10 seeds=20 executor.workers=8
  tacevo noise sweep=sweeps/NAME

"""

_CONTINUED = """\
The same command continues what was stopped. Several processes, on one or more machines that share the run and the
store, divide the work."""


def add_study(parser: Parser) -> None:
    """Describe `tacevo study`."""
    parser.description = (
        "Train the baseline and the best elites of a finished run, or of each job of a sweep, or networks of your\n"
        "own, fully, each with the same training seeds, and measure them on the test images. The exit status is 1 if\n"
        "a training or a job did not finish."
    )
    _finish(parser, SETTINGS, _EPILOG)
    parser.set_defaults(command=_study)


def add_noise(parser: Parser) -> None:
    """Describe `tacevo noise`."""
    parser.description = (
        "Train the baseline and the elites of a finished run, or of each job of a sweep, again as its search did, but\n"
        "with other training seeds, so that tables and report can say what its recorded fitnesses are worth. No test\n"
        "image is used. The exit status is 1 if a training or a job did not finish."
    )
    _finish(parser, NOISE_SETTINGS, _NOISE_EPILOG)
    parser.set_defaults(command=_noise)


def _finish(parser: Parser, described: Mapping[str, str], examples: str) -> None:
    """Describe what both commands have in common."""
    width = max(map(len, described))
    settings = "\n".join(f"  {name.ljust(width)}  {meaning}" for name, meaning in described.items())
    parser.epilog = f"settings, with their defaults:\n{settings}\n\n{examples}{_CONTINUED}"
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.fromfile_prefix_chars = "@"
    settings = "KEY=VALUE, or @FILE with one of them a line; RUN stands for run=RUN"
    parser.add_argument("overrides", nargs="*", metavar="RUN or SETTING", help=settings)


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


def _study(options: argparse.Namespace) -> int:
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
        with Progress() as view:
            studied = study(config, view, data)
    _introduce(studied, "study")
    _show(studied, config.store.root)
    return _end(studied, "raise seconds= or memory_mib=, or lower elites=")


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
    print(f"compare: {as_typed('tacevo')} ablations {shlex.quote(str(sweep))}")
    return DIFFERENT if unfinished else max(statuses)


def _noise(options: argparse.Namespace) -> int:
    config = _composed(compose_noise, options.overrides)
    if config.sweep is not None:
        return _noise_sweep(Path(config.sweep), config)
    with Progress() as view:
        studied = estimate_noise(config, view)
    _introduce(studied, "noise run")
    run = _show(studied, config.store.root)
    if run.answered and not run.shortfall:
        print(f"next:   {as_typed('tacevo')} study {shlex.quote(as_override('run', str(run.path)))} choose=reestimated")
    return _end(studied, "lower elites=")


def _introduce(studied: Studied, what: str) -> None:
    before = f", {studied.recorded} of them recorded already" if studied.recorded else ""
    print(f"{what}: {studied.directory} ({counted(studied.trainings, 'training')}{before})")


def _show(studied: Studied, store: str | None) -> RecordedRun:
    """Print what was found in short, and where all of it is to be seen; return the run."""
    run = read_run(studied.directory.parents[1], store)
    found = read_studies(run)
    if table := outcomes(run, found).get(studied.directory.name):
        print_table(table, Console())
        say(why for why in found.left_out if studied.directory.name in why)
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


_PLAN_EPILOG = """\
examples:
  tacevo plan study cache/published/grating-grammar.zip --effect 0.01
  tacevo plan sweep sweeps/PILOT --effect 0.05 --comparisons 3 -o plans
  tacevo study run=runs/NAME seeds=SEEDS plan=build/plan/plan.json
  tacevo search -m ... 'seed=range(0,SEEDS)' --plan plans/plan.json

The plan is kept in the study or the sweep that it is given to. docs/statistics.md says how it is simulated."""


def add_plan(parser: Parser) -> None:
    """Describe `tacevo plan`."""
    parser.description = (
        "Compute how many seeds are needed to detect an effect of a given size after Holm's correction, and the cost.\n"
        "The spread is that of finished pilot runs. The exit status is 1 if no number of seeds that is tried suffices."
    )
    parser.epilog = _PLAN_EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    kinds = parser.add_subparsers(title="what to plan", required=True, metavar="KIND")
    _add_kind(kinds.add_parser("study", help="training seeds of each network"), "RUN", "study", "variants")
    _add_kind(kinds.add_parser("sweep", help="jobs of each arm"), "SWEEP", "sweep", "arms beside the reference")


def _add_kind(parser: argparse.ArgumentParser, source: str, kind: str, compared: str) -> None:
    of_study = "a pilot run (directory or bundle; all its finished studies are used), or the directory of one study"
    of_sweep = "a pilot sweep (directory or bundle)"
    parser.add_argument("pilots", metavar=source, nargs="+", help=of_study if kind == "study" else of_sweep)
    parser.add_argument(
        "--effect",
        type=_part,
        required=True,
        help="what is to be found: a part of an error (0.1 is 10 %% less), or the difference of an accuracy",
    )
    parser.add_argument(
        "--comparisons", type=whole_number, metavar="N", help=f"{compared} (default: as many as the pilot)"
    )
    parser.add_argument("--power", type=_part, default=0.8, help="wished chance of finding it (0.8)")
    parser.add_argument("--alpha", type=_part, default=ALPHA, help=f"level of the tests, after Holm ({ALPHA:g})")
    parser.add_argument(
        "-o", "--output", metavar="DIR", default="build/plan", help="directory to write to (default: build/plan)"
    )
    parser.set_defaults(command=_plan, kind=kind)


def _plan(options: argparse.Namespace) -> int:
    pilot = _pilot(options.kind, [Path(name) for name in options.pilots])
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
    found = 0
    for folder in opened(path).runs:
        run = read_run(folder)
        for directory in studies_of(folder):
            record = directory.read()
            if record.terms is not None and record.digest is not None:
                found += 1
                yield run, load_study(directory.path)
    if not found:
        named = shlex.quote(as_override("run", str(path)))
        remedy = f"`tacevo study {named}` makes one; a few seeds will do for a pilot"
        raise RunError("none", place=str(path), expected="at least one finished study", remedy=remedy)


def _part(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0 < (value := float(text)) < 1:
            return value
    raise argparse.ArgumentTypeError(f"expected a number between 0 and 1, such as 0.1 for 10 %; got {text}")
