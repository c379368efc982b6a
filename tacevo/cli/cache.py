"""The commands `tacevo cache ...`; what they do is imported when they run, so that help is quick."""

import argparse
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, Parser
from tacevo.storage.store import KINDS


def add_cache(commands: "argparse._SubParsersAction[Parser]") -> None:
    """Describe the commands on the stores."""
    cache = commands.add_parser("cache", help="look into the stores of answers, and move what a run needs")
    actions = cache.add_subparsers(title="commands", required=True, metavar="COMMAND")

    ls = actions.add_parser("ls", help="count entries by kind and model, with sizes, tokens and costs")
    ls.add_argument("--kind", choices=KINDS, help="only these")
    ls.add_argument("--model", metavar="TEXT", help="only completions of models whose name contains TEXT")

    verify = actions.add_parser("verify", help="check every entry; status 1 where one is damaged")

    explain = actions.add_parser(
        "explain", help="what an entry is, or how a request differs from the nearest recording"
    )
    explain.add_argument("key", metavar="KEY", help="the first digits of a key, or a JSON file with a request")

    export = actions.add_parser("export", help="write exactly the entries that a run needs into one file")
    export.add_argument("run", metavar="RUN", help="the folder of a run")
    export.add_argument("-o", "--output", required=True, metavar="FILE")
    export.add_argument("--store", metavar="DIR", help="where its stores lie, if they were moved")
    export.set_defaults(command=_export)

    import_ = actions.add_parser("import", help="verify such a file, then write its entries into the stores")
    import_.add_argument("file", metavar="FILE")

    with_store = {ls: _ls, verify: _verify, explain: _explain, import_: _import}
    for parser, command in with_store.items():
        parser.add_argument("--store", default="cache", metavar="DIR", help="the folder of the stores (default: cache)")
        parser.set_defaults(command=command)


def _ls(options: argparse.Namespace) -> int:
    from tacevo.storage.listing import list_stores

    print(list_stores(Path(options.store), kind=options.kind, model=options.model))
    return DONE


def _verify(options: argparse.Namespace) -> int:
    from tacevo.storage.listing import verify

    problems, files = verify(Path(options.store))
    for problem in problems:
        print(problem)
    print(f"{files - len(problems)} of {files} entries are sound")
    return DIFFERENT if problems else DONE


def _explain(options: argparse.Namespace) -> int:
    from tacevo.storage.listing import explain

    print(explain(Path(options.store), options.key))
    return DONE


def _export(options: argparse.Namespace) -> int:
    from rich.console import Console

    from tacevo.reproduce.export import export
    from tacevo.runs.progress import PlainView

    with PlainView(Console(stderr=True)) as view:
        entries = export(Path(options.run), Path(options.output), options.store, view)
    print(f"{entries} entries are in {options.output}")
    return DONE


def _import(options: argparse.Namespace) -> int:
    from tacevo.reproduce.export import import_file

    written, standing = import_file(Path(options.file), Path(options.store))
    print(f"{written} entries written, {standing} were there already")
    return DONE
