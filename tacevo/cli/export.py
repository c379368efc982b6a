"""The command `tacevo export`."""

import argparse
from typing import Any

from tacevo.cli.arguments import RUN, candidate, named
from tacevo.cli.common import DONE, Parser, existing_store
from tacevo.errors import ConfigError
from tacevo.text import printable


def add_export(parser: Parser) -> None:
    """Describe `tacevo export`."""
    parser.description = (
        "Train a candidate again in the sandbox, and write it as a directory that needs no tacevo: the class, its "
        "weights, ONNX, torch.export, a model card. Needs `pip install 'tacevo[export]'`."
    )
    parser.add_argument("run", metavar="RUN", type=named, help=RUN)
    parser.add_argument("candidate", metavar="CANDIDATE", type=candidate, help="its id, e.g. g02s03")
    parser.add_argument(
        "overrides",
        metavar="KEY=VALUE",
        nargs="*",
        help="seeds=K, an ensemble of K trainings; epochs=N; like=study, the default, or like=search; licence=ID",
    )
    parser.add_argument("-o", "--output", metavar="DIR", required=True, help="the directory, which must not exist")
    parser.add_argument("--store", metavar="DIR", help="the directory of its stores, if they were moved")
    parser.add_argument(
        "--retrained",
        action="store_true",
        help="fail where a training is not recorded, or goes otherwise than recorded",
    )
    parser.set_defaults(command=run_export)


def run_export(options: argparse.Namespace) -> int:
    """Write a network as a directory of its own."""
    from tacevo.api.opening import open_run  # what reads a run takes a second to import

    run = open_run(options.run, store=existing_store(options.store))
    settings = dict(map(_setting, options.overrides))
    run.export(options.candidate, options.output, retrained=options.retrained, **settings)
    print(printable(f"{options.output}: README.md says how to use it"))
    return DONE


def _setting(text: str) -> tuple[str, Any]:
    """Read `KEY=VALUE`."""
    key, equals, value = text.partition("=")
    if not equals or key in {"retrained", "quiet"}:
        raise ConfigError(text, place="tacevo export", expected="KEY=VALUE, such as seeds=3")
    return key, int(value) if value.isdecimal() else value
