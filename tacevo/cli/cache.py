"""The commands `tacevo cache ...`."""

import argparse
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, Parser, agreed, existing_store, tell
from tacevo.reproduce.entry_files import import_file, write_entries
from tacevo.reproduce.prune import unused
from tacevo.runs.progress import Progress
from tacevo.storage.files import remove_leftovers
from tacevo.storage.listing import list_entries, verify
from tacevo.text import counted


def add_cache(parser: Parser) -> None:
    """Describe the commands on the stores."""
    actions = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    verify = actions.add_parser("verify", help="check every entry; the exit status is 1 if one is damaged")

    export = actions.add_parser("export", help="write exactly the entries that a run needs into one file")
    export.add_argument("run", metavar="RUN", help="the directory of a run")
    export.add_argument("-o", "--output", required=True, metavar="FILE")
    export.add_argument("--store", metavar="DIR", help="the directory of its stores, if they were moved")
    export.set_defaults(command=_export)

    import_ = actions.add_parser("import", help="verify such a file, then write its entries into the stores")
    import_.add_argument("file", metavar="FILE")

    prune = actions.add_parser("prune", help="remove the entries that no run here needs, after a question")
    prune.add_argument("runs", metavar="DIR", nargs="*", default=["."], help="directories of runs (default: this one)")
    prune.add_argument("-y", "--yes", action="store_true", help="ask nothing")

    with_store = {verify: _verify, import_: _import, prune: _prune}
    for action, command in with_store.items():
        action.add_argument("--store", default="cache", metavar="DIR", help="directory of the stores (default: cache)")
        action.set_defaults(command=command)


def _verify(options: argparse.Namespace) -> int:
    problems, files = verify(Path(options.store))
    for problem in problems:
        tell(problem)
    tell(f"{files - len(problems)} of {files} entries are sound")
    return DIFFERENT if problems else DONE


def _prune(options: argparse.Namespace) -> int:
    root = Path(existing_store(options.store) or "")
    remove_leftovers(root)  # also of earlier releases, which began an entry beside its place
    with Progress() as view:
        files, runs = unused(root, [Path(folder) for folder in options.runs], view)
    if not files:
        tell(f"every entry of {root} is needed by {counted(runs, 'run')}")
        return DONE
    tell(list_entries(root, files))
    tell(f"{counted(runs, 'run')} here need none of these. A run elsewhere may; a model's answers would be paid again.")
    if not agreed(f"remove {counted(len(files), 'file')} from {root}?", options.yes):
        return DIFFERENT
    for file in files:
        file.unlink(missing_ok=True)
    tell(f"removed: {counted(len(files), 'file')}; images stay in {root / 'data'}, and are made again where they lack")
    return DONE


def _export(options: argparse.Namespace) -> int:
    with Progress() as view:
        entries = write_entries(Path(options.run), Path(options.output), options.store, view)
    tell(f"{entries} entries are in {options.output}")
    return DONE


def _import(options: argparse.Namespace) -> int:
    written, standing, passed_over = import_file(Path(options.file), Path(options.store))
    tell(f"{written} entries written, {standing} were there already")
    if passed_over:
        tell(f"{passed_over} passed over: files of candidates, and full trainings without their test predictions")
    return DONE
