"""The commands `tacevo study`, of a run or of the jobs of a sweep, and `tacevo noise`."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from tacevo.cli.common import DIFFERENT, DONE, Parser
from tacevo.config.compose import compose_noise, compose_study
from tacevo.config.given import check_unchosen, compose_given, gives_networks
from tacevo.config.study import NoiseConfig, StudyConfig
from tacevo.errors import ConfigError
from tacevo.runs.progress import Progress
from tacevo.storage.run_directory import RunDirectory
from tacevo.studies.given import record_given
from tacevo.studies.of_sweep import study_sweep
from tacevo.studies.study import Studied, estimate_noise, study
from tacevo.text import counted, listed

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
    "executor.address": "of that cluster, as HOST:PORT or auto; none starts a Ray here",
    "store.root": "the directory of the stores (that of the run)",
}

#: The same of a noise run; conf/noise.yaml has the defaults.
NOISE_SETTINGS = {
    "run": "the directory of a finished run; required, and may stand alone: RUN",
    "elites": "how many elites, best validation loss first, beside the baseline (all)",
    "seeds": "training seeds of each network (5)",
    **{key: SETTINGS[key] for key in ("executor", "executor.workers", "executor.address")},
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
        "Train the baseline and the elites of a finished run again, as its search did, but with other training seeds,\n"
        "so that tables and report can say what its recorded fitnesses are worth. No test image is used. The exit "
        "status\nis 1 if a training did not finish."
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
    parser.set_defaults(interrupted="the trainings that ended are kept, and the same command continues")


def _runs(words: Sequence[str]) -> list[str]:
    """Return the bare words, each of which names a run."""
    return [word for word in words if "=" not in word or Path(word).exists()]


def _composed(compose: Callable[[Sequence[str]], Configured], words: Sequence[str]) -> Configured:
    """Compose the settings of a command, one of which, the run, may be given as a bare word.

    Raises:
        ConfigError: as `compose`, or two runs are named.
    """
    runs = _runs(words)
    settings = [word for word in words if word not in runs]
    if not runs:
        return compose(settings)
    others = [setting for setting in settings if setting.startswith(("run=", "sweep=", "networks="))]
    if named := [*runs[1:], *others]:
        raise ConfigError(listed([runs[0], *named]), place="run", expected="one run, as RUN or run=RUN")
    return replace(compose([*settings, "run=RUN"]), run=runs[0])


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
    return _report(studied, "study", "raise seconds= or memory_mib=, or lower elites=")


def _study_sweep(sweep: Path, config: StudyConfig) -> int:
    with Progress() as view:
        studied = study_sweep(sweep, config, view)
    statuses = [_report(one, "study", "raise seconds= or memory_mib=") for one in studied.studies]
    for job in studied.unfinished:
        print(f"not studied, for it is not finished: {job}")
    print(f"compare: tacevo ablations {sweep}")
    return DIFFERENT if studied.unfinished else max(statuses)


def _noise(options: argparse.Namespace) -> int:
    config = _composed(compose_noise, options.overrides)
    with Progress() as view:
        studied = estimate_noise(config, view)
    return _report(studied, "noise run", "lower elites=")


def _report(studied: Studied, what: str, remedy: str) -> int:
    """Print what was trained; return the exit status."""
    before = f", {studied.recorded} of them recorded already" if studied.recorded else ""
    print(f"{what}: {studied.directory} ({counted(studied.trainings, 'training')}{before})")
    for row in studied.failed:
        print(f"failed: {row}")
    if studied.failed:
        print(f"no statistics without these: {remedy}")
    print(f"digest: {studied.digest}")
    return DIFFERENT if studied.failed else DONE
