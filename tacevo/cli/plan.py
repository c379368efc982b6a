"""The command `tacevo plan`: how many seeds a study or a sweep needs."""

import argparse
from pathlib import Path

from rich.console import Console

from analysis.tables.plan import plan_table
from tacevo.api.planning import planned_from, write_plan
from tacevo.cli.common import DIFFERENT, DONE, output_directory, tell
from tacevo.cli.tables import print_table


def run_plan(options: argparse.Namespace) -> int:
    """Plan a number of seeds."""
    directory = output_directory(options.output)
    wish = {name: getattr(options, name) for name in ("effect", "comparisons", "power", "alpha")}
    planned = planned_from(options.kind, [Path(name) for name in options.runs], **wish)
    print_table(plan_table(planned), Console())
    if planned.plan is None:
        tell("no plan: wish for a larger effect or a lower power, or compare fewer")
        return DIFFERENT
    made = write_plan(planned.plan, directory)
    tell(f"plan: {directory / 'plan.json'}, {made.dated}")
    return DONE
