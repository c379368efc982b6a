"""The command `tacevo judge`."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, TO_CITE, output_directory, tell
from tacevo.cli.tabulate import NICE
from tacevo.environment import as_typed
from tacevo.errors import ConfigError
from tacevo.reproduce.space_table import verify_table
from tacevo.results.space_table import read_table
from tacevo.runs.progress import Progress
from tacevo.sandbox.kernel import lower_priority
from tacevo.studies.judge import judge_table


def run_judge(
    path: str, overrides: Sequence[str], output: str, *, networks: int, seeds: int, part: tuple[int, int] | None
) -> int:
    """Train the judge of a table, or a part of it; the status is 1 if a training failed."""
    target = Path(output)
    output_directory(target.parent)
    if target.is_dir():
        raise ConfigError(f"the directory {target}", place="-o", expected="the file to write")
    table = read_table(Path(path))
    verify_table(table)
    number, parts = part or (1, 1)
    lower_priority(NICE)
    with Progress() as view:
        view.say(f"at low priority (nice {NICE}): other work of this machine goes first")
        judged = judge_table(
            table, overrides, target, view, networks=networks, seeds=seeds, number=number - 1, parts=parts
        )
    written = judged.table
    if written is None:
        tell(f"part {number} of {parts} is trained; without --part this trains what is left, and writes {output}")
    else:
        tell(f"table:  {output} ({written.name})")
    for line in judged.failures:
        tell(f"failed: {line}")
    if written is not None and written.judge is not None:
        tell(f"verify: {as_typed('tacevo')} replay {shlex.quote(output)} --retrain 5")
        tell(f"judge:  its digest is {written.judge.digest}")
        tell(f"cite:   {TO_CITE.format('table with its judge')}")
        tell(f"digest: {written.digest}")
    return DIFFERENT if judged.failures else DONE
