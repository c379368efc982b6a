"""The command `tacevo continue`."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from tacevo.commandline import DONE, OVERRIDE, Parser
from tacevo.publish_commands import verify_bundle

if TYPE_CHECKING:
    from tacevo.opening import Opened
    from tacevo.progress import View


def add_continue(commands: "argparse._SubParsersAction[Parser]") -> None:
    """Describe `tacevo continue`."""
    command = commands.add_parser(
        "continue",
        help="take up a published run where it ended",
        description="Replay a finished run, and search on from its end in a run directory of its own, whose ledger "
        "begins with the very lines of the published one. The published run and its stores are only read.",
    )
    command.add_argument("run", metavar="RUN", help="the folder of a run, or a file that `tacevo publish` wrote")
    command.add_argument("overrides", nargs="*", metavar="OVERRIDE", help=f"{OVERRIDE}; search.generations=N is needed")
    command.add_argument(
        "--rules",
        choices=["current"],
        help="search on under this release's rules where the run has others; the ledger records the change",
    )
    command.add_argument("--store", metavar="DIR", help="where its stores lie, if they were moved")
    command.set_defaults(command=_continue)


def _continue(options: argparse.Namespace) -> int:
    from dataclasses import replace

    from rich.console import Console

    from tacevo.continuing import continue_run
    from tacevo.opening import opened
    from tacevo.progress import PlainView

    with opened(Path(options.run)) as found, PlainView(Console(stderr=True)) as view:
        moved = found.root is None and options.store is not None
        published = replace(found, store=Path(options.store)) if moved else found
        mix = options.rules is not None
        result = continue_run(published, options.overrides, view, check=lambda run: _checked(run, view), mix_rules=mix)
    print(result.summary)
    print(f"run: {result.directory}")
    print(f"digest: {result.digest}")
    return DONE


def _checked(published: "Opened", view: "View") -> set[Path]:
    """Replay a run, and of a bundle verify all of it; give the store entries that it needs."""
    from tacevo.replaying import replay

    if published.root is not None:
        verify_bundle(published, view)
        return set(published.store.rglob("*.json"))
    read: set[Path] = set()
    replay(published.folder, str(published.store), view, seen=read.add)
    return read
