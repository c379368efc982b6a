"""The command `tacevo plan`: how many seeds a study or a sweep needs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from rich.console import Console

from analysis.tables.plan import plan_table
from tacevo.api.planning import planned_from, write_plan
from tacevo.cli.common import DIFFERENT, DONE, output_directory, tell
from tacevo.cli.tables import print_table
from tacevo.errors import ConfigError
from tacevo.storage.plan_file import describe_plan
from tacevo.storage.signatures import checked_key


def run_plan(kind: Literal["study", "sweep"], runs: Sequence[str], output: str, key: str | None, **wish: Any) -> int:
    """Plan a number of seeds, and sign the plan with a key; the wish is that of `planned_from`."""
    signing_key = None if key is None else checked_key(Path(key))
    directory = output_directory(output)
    planned = planned_from(kind, [Path(name) for name in runs], **wish)
    print_table(plan_table(planned), Console())
    if planned.plan is None:
        tell("no plan: wish for a larger effect or a lower power, or compare fewer")
        return DIFFERENT
    made = write_plan(planned.plan, directory, signing_key)
    tell(f"plan: {directory / 'plan.json'}, {describe_plan(made, None, ConfigError)}")
    return DONE
