"""The commands `tacevo cache ...`."""

import argparse
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, Parser
from tacevo.reproduce.entry_files import import_file, write_entries
from tacevo.runs.progress import Progress
from tacevo.storage.listing import list_stores, verify


def add_cache(parser: Parser) -> None:
    """Describe the commands on the stores."""
    actions = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    ls = actions.add_parser("ls", help="count entries by kind and model, with sizes, tokens and costs")

    verify = actions.add_parser("verify", help="check every entry; the exit status is 1 if one is damaged")

    export = actions.add_parser("export", help="write exactly the entries that a run needs into one file")
    export.add_argument("run", metavar="RUN", help="the directory of a run")
    export.add_argument("-o", "--output", required=True, metavar="FILE")
    export.add_argument("--store", metavar="DIR", help="the directory of its stores, if they were moved")
    export.set_defaults(command=_export)

    import_ = actions.add_parser("import", help="verify such a file, then write its entries into the stores")
    import_.add_argument("file", metavar="FILE")

    with_store = {ls: _ls, verify: _verify, import_: _import}
    for action, command in with_store.items():
        action.add_argument("--store", default="cache", metavar="DIR", help="directory of the stores (default: cache)")
        action.set_defaults(command=command)


def _ls(options: argparse.Namespace) -> int:
    print(list_stores(Path(options.store)))
    return DONE


def _verify(options: argparse.Namespace) -> int:
    problems, files = verify(Path(options.store))
    for problem in problems:
        print(problem)
    print(f"{files - len(problems)} of {files} entries are sound")
    return DIFFERENT if problems else DONE


def _export(options: argparse.Namespace) -> int:
    with Progress() as view:
        entries = write_entries(Path(options.run), Path(options.output), options.store, view)
    print(f"{entries} entries are in {options.output}")
    return DONE


def _import(options: argparse.Namespace) -> int:
    written, standing, passed_over = import_file(Path(options.file), Path(options.store))
    print(f"{written} entries written, {standing} were there already")
    if passed_over:
        print(f"{passed_over} passed over: files of candidates, and full trainings without their test predictions")
    return DONE
