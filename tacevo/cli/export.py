"""The command `tacevo export`."""

import argparse
import re
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from tacevo.cli.arguments import RUN, candidate, named
from tacevo.cli.common import DONE, Parser, existing_store
from tacevo.errors import ConfigError
from tacevo.text import printable


def add_export(parser: Parser) -> None:
    """Describe `tacevo export`."""
    parser.description = (
        "Train a candidate again in the sandbox, and write it as a directory that needs no tacevo: the class, its "
        "weights, ONNX, torch.export, a model card. Needs `pip install -e '.[export]'`."
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
    parser.add_argument("--register", metavar="NAME", help="register the ONNX model in MLflow, too")
    parser.add_argument(
        "--uri", default="", help="MLflow tracking URI (default: the run's own, else MLFLOW_TRACKING_URI)"
    )
    parser.set_defaults(command=run_export)


def run_export(options: argparse.Namespace) -> int:
    """Write a network as a directory of its own."""
    from tacevo.api.opening import open_run  # what reads a run takes a second to import

    run = open_run(options.run, store=existing_store(options.store))
    settings = _settings(options.overrides)
    to = {"register": options.register, "uri": options.uri}
    run.export(options.candidate, options.output, retrained=options.retrained, **to, **settings)
    print(printable(f"{options.output}: README.md says how to use it"))
    return DONE


def _settings(overrides: Sequence[str]) -> dict[str, Any]:
    """Read `KEY=VALUE` words."""
    from tacevo.export.trainings import ExportSettings  # composes the recipe of a study, with Hydra

    known = [field.name for field in fields(ExportSettings)]
    settings: dict[str, Any] = {}
    for text in overrides:
        key, _, value = text.partition("=")
        if key not in known or key in settings or not value:
            expected = f"{', '.join(known)}, each once, as KEY=VALUE"
            raise ConfigError(text[:100], place="tacevo export", expected=expected, remedy="see tacevo export --help")
        settings[key] = int(value) if re.fullmatch(r"\d{1,9}", value) else value
    return settings
