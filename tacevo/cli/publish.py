"""The command `tacevo publish`."""

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from tacevo.api.pages import pages
from tacevo.bundles.deposit import check_deposit, deposit
from tacevo.bundles.publish import publish
from tacevo.bundles.readme import Terms
from tacevo.bundles.signing import sign_bundle, signature_of
from tacevo.cli.common import DONE, TO_CITE, tell
from tacevo.runs.progress import Progress
from tacevo.storage.signatures import checked_key
from tacevo.text import counted, listed


def _asked() -> tuple[str, ...]:
    """Ask who publishes, before the work: with another author it is another bundle. Without a terminal say it."""
    if sys.stdin.isatty() and sys.stderr.isatty():
        tell("author, as it shall be cited (nothing: anonymous): ", error=True, end="", flush=True)
        name = sys.stdin.readline().strip()
        return (name,) if name else ()
    tell("author: anonymous; --author NAME says who, and it is another bundle then", error=True)
    return ()


def run_publish(
    run: str,
    studies: Sequence[str],
    output: str,
    *,
    store: str | None,
    licence: str,
    authors: Sequence[str],
    date: str,
    key: str | None,
    deposited: str | None,
) -> int:
    """Publish a run or a sweep as a file."""
    signing_key = None if key is None else checked_key(Path(key))
    terms = Terms(licence=licence, authors=tuple(authors) or _asked(), published=date)
    if deposited is not None:
        check_deposit(Path(deposited), terms.authors)
    with Progress() as view:
        done = publish(
            Path(run),
            Path(output),
            terms=terms,
            make_pages=partial(pages, say=view.say),
            view=view,
            studies=tuple(map(Path, studies)),
            store=None if store is None else Path(store),
        )
    sign_bundle(Path(output), done.digest, signing_key)
    tell(f"published: {output} ({counted(done.files, 'file')}, {done.size / 1e6:.2f} MB)")
    tell(f"licence: {terms.licence}")
    tell(f"author: {listed(terms.authors, 'anonymous (--author NAME says who)')}")
    if done.test_labels:
        tell(f"the labels of {counted(done.test_labels, 'test image')} are in it")
    if signing_key is not None:
        tell(f"signature: {signature_of(Path(output))}, of the bundle digest; it lies beside the bundle")
    if deposited is not None:
        files = deposit(Path(output), Path(deposited))
        tell(f"deposit: {deposited} ({listed(files)}); upload all of it, and write the DOI into {output}.doi")
    tell(f"bundle digest: {done.digest} (of all its files)")
    tell(f"cite:   {TO_CITE.format(done.subject.what)}")
    tell(f"digest: {done.subject.digest}")
    return DONE
