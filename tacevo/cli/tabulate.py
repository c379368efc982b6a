"""The command `tacevo tabulate`."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, TO_CITE, output_directory, tell
from tacevo.config.compose import compose
from tacevo.config.conf_folder import check_experiment
from tacevo.environment import as_typed
from tacevo.errors import ConfigError
from tacevo.runs.progress import Progress
from tacevo.sandbox.kernel import lower_priority
from tacevo.studies.tabulate import tabulate

#: The niceness of hours of trainings, which a desk's other work must not wait for.
NICE = 10


def run_tabulate(overrides: Sequence[str], output: str, seeds: int) -> int:
    """Make the table of a space; the status is 1 if a network was refused or failed to train."""
    config = compose(overrides)
    check_experiment(overrides)
    target = Path(output)
    output_directory(target.parent)
    if target.is_dir():
        raise ConfigError(f"the directory {target}", place="-o", expected="the file to write")
    lower_priority(NICE)
    with Progress() as view:
        view.say(f"at low priority (nice {NICE}): other work of this machine goes first")
        table = tabulate(config, target, view, seeds=seeds)
    tell(f"table:  {output} ({table.name})")
    for line in table.failures:
        tell(f"failed: {line}")
    place = shlex.quote(output)
    tell(f"verify: {as_typed('tacevo')} replay {place} --retrain 5")
    tell(f"next:   {as_typed('tacevo')} search experiment=space data=table data.root={place}")
    tell(f"cite:   {TO_CITE.format('table')}")
    tell(f"digest: {table.digest}")
    return DIFFERENT if table.failures else DONE
