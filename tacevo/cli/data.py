"""The commands `tacevo data ...`."""

import argparse
import json

from rich.console import Console

from tacevo.cli.common import DIFFERENT, DONE, OVERRIDE, Parser, add_config_dir, tell
from tacevo.records import to_json
from tacevo.runs.data_check import inspect_data, show, simulate
from tacevo.runs.data_report import report

_EPILOG = """\
examples:
  tacevo data check task=force
  tacevo data check experiment=published_force data=tacverse data.root=DIR
  tacevo data show task=grating -o gratings.pdf
  tacevo data simulate task=force n=3000 out=simulated
"""


def add_data(parser: Parser) -> None:
    """Describe `tacevo data` and its commands."""
    parser.description = "Look at a data set before a search, or write a simulated one as files."
    parser.epilog = _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.set_defaults(interrupted="nothing half-made is left")
    choices = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    check = choices.add_parser(
        "check",
        help="load a data set as a search would, count it, and draw a contact sheet",
        description="Load a data set as a search would, count it, and draw a contact sheet. "
        "The exit status is 1 if two splits share an image.",
    )
    check.add_argument("-o", "--output", metavar="FILE", help="the contact sheet: .png, .pdf or .svg")
    check.add_argument("--json", action="store_true", help="the findings as one JSON object")

    show = choices.add_parser(
        "show",
        help="draw a few samples with their labels, for a paper",
        description="Draw a few samples with their labels: one of each class or level, or from the least to the most.",
    )
    show.add_argument("-o", "--output", metavar="FILE", required=True, help="the figure: .png, .pdf or .svg")
    show.add_argument("--width", choices=["single", "double"], default="double", help="columns of a paper")

    line = "write a simulated data set as images and a table of labels"
    simulate = choices.add_parser("simulate", help=line, description=f"W{line[1:]}; the directory is whole or absent.")

    settings = f"out=DIR, n=IMAGES, or an override: {OVERRIDE}"
    takes = {check: (_check, "*", "OVERRIDE", OVERRIDE), show: (_show, "*", "OVERRIDE", OVERRIDE)}
    for action, (command, count, name, words) in {**takes, simulate: (_simulate, "+", "SETTING", settings)}.items():
        action.fromfile_prefix_chars = "@"
        action.add_argument("overrides", nargs=count, metavar=name, help=words)
        add_config_dir(action)
        action.set_defaults(command=command)


def _check(options: argparse.Namespace) -> int:
    inspection = inspect_data(options.overrides, options.output, Console(stderr=True))
    tell(json.dumps(to_json(inspection), indent=2) if options.json else report(inspection))
    return DIFFERENT if inspection.leaks else DONE


def _show(options: argparse.Namespace) -> int:
    tell(f"look: {show(options.overrides, options.output, options.width, Console(stderr=True))}")
    return DONE


def _simulate(options: argparse.Namespace) -> int:
    tell(simulate(options.overrides, Console(stderr=True)))
    return DONE
