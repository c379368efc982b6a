"""Commands: a word behind `tacevo`."""

from argparse import ArgumentParser, Namespace
from pathlib import Path


def mine(parser: ArgumentParser) -> None:
    """Count the lines of a run's ledger."""
    parser.add_argument("run", type=Path, help="the directory of a run")
    parser.set_defaults(command=_run)


def _run(options: Namespace) -> int:
    """Run the command; return its exit status."""
    print(len((options.run / "ledger.jsonl").read_text(encoding="utf-8").splitlines()))
    return 0
