"""A run or a sweep run again from its records, whether it is a directory or a bundle; and a run continued."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tacevo.bundles.open import Opened
from tacevo.bundles.verify import Verified, rerun, rerun_all, rerun_published, verify
from tacevo.reproduce.replay import replay as replay_search
from tacevo.runs.progress import Progress
from tacevo.storage.sweep_directory import sweep_digest

if TYPE_CHECKING:
    from tacevo.runs.session import Result


def digest_of(place: Opened, done: Verified) -> str:
    """Return the digest of a run, or of a sweep, that was run again."""
    digests = [run.replayed.digest for run in done.runs]
    return digests[0] if place.jobs is None else sweep_digest(dict(zip(place.jobs, digests, strict=True)))


def replay(place: Opened, store: str | None, view: Progress, *, trusts: bool = False) -> Verified:
    """Run searches and studies again from their stores, and compare every line; of a bundle, all that its records give.

    `store` is where the stores of a directory lie, if they were moved; a bundle has its own. With `trusts`, the parts
    that a user brought decide again, by their recorded sources in confined processes.

    Raises:
        DivergenceError: the first difference.
        CacheMissError: a store lacks an answer.
        BundleError: the records of a bundle do not suit each other.
    """
    if place.digest is None:
        return Verified(runs=rerun_all(place, lambda run: rerun(place.read(run, store), view, trusts=trusts), view))
    if place.root is None:
        return Verified(runs=(rerun_published(place, place.folder, view, trusts=trusts),))
    return verified_bundle(place, view, trusts=trusts)


def verified_bundle(bundle: Opened, view: Progress, *, trusts: bool = False) -> Verified:
    """Verify a bundle with the tables of the analysis; `trusts` is as of `replay`."""
    from tacevo.api.pages import can_make, table_files  # what computes tables takes two seconds to import

    return verify(bundle, partial(table_files, say=view.say), view, can_make=can_make, trusts=trusts)


def extended(published: Opened, overrides: Sequence[str], view: Progress, *, trusts: bool = False) -> Result:
    """Search on from the end of a run, once it was compared with what its stores give.

    `trusts` is as of `replay`; a run in which a part of a user's decides is searched on only with it.

    Raises:
        TacevoError: as `tacevo.bundles.extend.extend_run`.
    """
    from tacevo.bundles.extend import extend_run  # imports Hydra, which a replay does not need

    return extend_run(published, overrides, view, check=lambda run: _checked(run, view, trusts), trusts=trusts)


def _checked(published: Opened, view: Progress, trusts: bool) -> set[Path]:
    """Replay a run, and of a bundle verify all of it; return the store entries that it needs."""
    if published.root is not None:
        verified_bundle(published, view, trusts=trusts)
        return set(published.store.glob("*/*/*.json"))
    read: set[Path] = set()
    if published.digest is not None:  # compares its studies, too, whose entries a search does not need
        rerun_published(published, published.folder, view, trusts=trusts)
    replay_search(published.read(published.folder), view, seen=read.add, trusts=trusts)
    return read
