"""The command `tacevo rm`."""

import argparse
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, Parser, agreed, tell
from tacevo.storage.removal import removable
from tacevo.text import table


def add_rm(parser: Parser) -> None:
    """Describe `tacevo rm`."""
    parser.description = (
        "Remove the directory of a run or a sweep, with its studies, tables and whatever else lies there, after a "
        "question. One that a process is at work in, or that something else needs, is refused. Its answers stay in "
        "the stores; `tacevo cache prune` removes those that no run needs. The exit status is 1 if the answer is no."
    )
    parser.add_argument("run", metavar="RUN", help="the directory of a run or a sweep")
    parser.add_argument("-y", "--yes", action="store_true", help="ask nothing")
    parser.set_defaults(command=_rm, interrupted="what is not gone yet lies in a hidden directory beside it")


def _rm(options: argparse.Namespace) -> int:
    path = Path(options.run)
    with removable(path) as remove:
        rows = [[each.name, f"{_size(each) / 1e6:.2f} MB"] for each in sorted(path.iterdir()) if each.name != ".lock"]
        tell(table(["goes", "size"], rows))
        if not agreed(f"remove {path}?", options.yes):
            return DIFFERENT
        remove()
    tell(f"removed: {path}; its answers stay in the stores (`tacevo cache prune`)")
    return DONE


def _size(path: Path) -> int:
    files = [path, *path.rglob("*")] if path.is_dir() else [path]
    return sum(file.lstat().st_size for file in files if not file.is_dir())
