"""The command `tacevo study`."""

import argparse

from tacevo.cli.common import DIFFERENT, DONE, Parser
from tacevo.config.compose import compose_study
from tacevo.runs.progress import Progress
from tacevo.studies.study import study
from tacevo.text import counted

#: What may be set, and what it means; conf/study.yaml has the defaults.
SETTINGS = {
    "run": "the directory of a finished run; required",
    "elites": "how many elites, best validation loss first, beside the baseline (4)",
    "seeds": "training seeds of each network (20)",
    "epochs": "of each training; the weights of the best validation epoch are tested (50)",
    "seconds": "the longest time of one training (86400)",
    "memory_mib": "the most memory of one training (4096)",
    "alpha": "level of the tests, after Holm (0.05)",
    "margins.regression.value": "the largest difference of the test MSE that counts as none (0.1)",
    "margins.regression.kind": "relative (to the baseline's median), or absolute; the first unless set",
    "margins.classification.value": "the same for the test accuracy (0.01)",
    "margins.classification.kind": "absolute (in the metric itself), or relative; the first unless set",
    "executor.workers": "trainings at once (2)",
    "store.root": "the directory of the stores (that of the run)",
}

_EPILOG = """\
examples:
  tacevo study run=runs/NAME
  tacevo study run=runs/NAME elites=2 seeds=5 epochs=10 executor.workers=8
  tacevo study run=runs/NAME margins.regression.value=0.05

The same command continues a study that was stopped. Several processes, on one or more machines that share the run and
the store, divide the work."""


def add_study(parser: Parser) -> None:
    """Describe `tacevo study`."""
    width = max(map(len, SETTINGS))
    settings = "\n".join(f"  {name.ljust(width)}  {meaning}" for name, meaning in SETTINGS.items())
    parser.description = (
        "Train the baseline and the best elites of a finished run fully, each with the same training seeds, and "
        "measure\nthem on the test images. The exit status is 1 if a training did not finish."
    )
    parser.epilog = f"settings, with their defaults:\n{settings}\n\n{_EPILOG}"
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.fromfile_prefix_chars = "@"
    parser.add_argument("overrides", nargs="*", metavar="SETTING", help="KEY=VALUE, or @FILE with one of them a line")
    parser.set_defaults(command=_study, interrupted="the trainings that ended are kept, and the same command continues")


def _study(options: argparse.Namespace) -> int:
    config = compose_study(options.overrides)
    with Progress() as view:
        studied = study(config, view)
    before = f", {studied.recorded} of them recorded already" if studied.recorded else ""
    print(f"study: {studied.directory} ({counted(studied.trainings, 'training')}{before})")
    for row in studied.failed:
        print(f"failed: {row}")
    if studied.failed:
        print("no statistics without these: raise seconds= or memory_mib=, or lower elites=")
    print(f"digest: {studied.digest}")
    return DIFFERENT if studied.failed else DONE
