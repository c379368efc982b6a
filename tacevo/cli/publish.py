"""The command `tacevo publish`."""

import argparse
from functools import partial
from pathlib import Path

from tacevo.api.pages import pages
from tacevo.bundles.publish import publish
from tacevo.bundles.readme import Terms
from tacevo.cli.common import DONE, tell
from tacevo.runs.progress import Progress
from tacevo.text import counted, listed


def run_publish(options: argparse.Namespace) -> int:
    """Publish a run or a sweep."""
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
    tell(f"published: {options.output} ({counted(done.files, 'file')}, {done.size / 1e6:.2f} MB)")
    tell(f"licence: {terms.licence}")
    tell(f"author: {listed(terms.authors, 'anonymous (--author NAME says who)')}")
    if done.test_labels:
        tell(f"the labels of {counted(done.test_labels, 'test image')} are in it")
    tell(f"{done.subject.what}: {done.subject.digest}")
    tell(f"bundle digest: {done.digest}")
    return DONE
