"""The command `tacevo publish`."""

import argparse
from functools import partial
from pathlib import Path

from tacevo.api.pages import pages
from tacevo.bundles.pages import Terms
from tacevo.bundles.publish import publish
from tacevo.cli.common import DONE, Parser
from tacevo.runs.progress import Progress
from tacevo.text import counted, listed


def add_publish(parser: Parser) -> None:
    """Describe `tacevo publish`."""
    parser.description = (
        "Replay a finished run or sweep and its studies, and write all that a replay elsewhere needs, with tables, "
        "figures, licence and checksums, into one file: an RO-Crate."
    )
    parser.add_argument("run", metavar="RUN", help="the directory of a run or of a sweep")
    parser.add_argument(
        "studies", metavar="STUDY", nargs="*", help="the directory of a study of a run (default: all finished ones)"
    )
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="e.g. run.zip")
    parser.add_argument("--store", metavar="DIR", help="the directory of the run's stores, if they were moved")
    parser.add_argument(
        "--license", default="CC-BY-4.0", metavar="SPDX", help="of what is published (default: CC-BY-4.0)"
    )
    parser.add_argument("--author", action="append", default=[], metavar="NAME", help="may be given several times")
    parser.add_argument("--date", default="", metavar="YYYY-MM-DD", help="of publication (default: the end of the run)")
    parser.set_defaults(command=_publish, interrupted="nothing was written; the same command begins again")


def _publish(options: argparse.Namespace) -> int:
    terms = Terms(licence=options.license, authors=tuple(options.author), published=options.date)
    with Progress() as view:
        done = publish(
            Path(options.run),
            Path(options.output),
            terms=terms,
            make_pages=partial(pages, say=view.say),
            view=view,
            studies=tuple(map(Path, options.studies)),
            store=None if options.store is None else Path(options.store),
        )
    print(f"published: {options.output} ({counted(done.files, 'file')}, {done.size / 1e6:.2f} MB)")
    print(f"licence: {terms.licence}")
    print(f"author: {listed(terms.authors, 'anonymous (--author NAME says who)')}")
    if done.test_labels:
        print(f"the labels of {counted(done.test_labels, 'test image')} are in it")
    print(f"{done.subject.what}: {done.subject.digest}")
    print(f"bundle digest: {done.digest}")
    return DONE
