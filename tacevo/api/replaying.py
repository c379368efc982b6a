"""A run or a sweep run again from its records, whether it is a directory or a bundle."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from tacevo.bundles.open import Opened
from tacevo.bundles.verify import Rerun, Verified, rerun, rerun_all, rerun_published, verify
from tacevo.runs.progress import Progress
from tacevo.storage.sweep_directory import sweep_digest


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """What was run again, and found to be as recorded."""

    #: The names of a sweep's jobs; None of one run.
    jobs: Sequence[str] | None
    #: One, or those of a sweep's jobs in their order.
    runs: Sequence[Rerun]
    #: What of a bundle was compared beside its searches and studies; None of a directory, and of one job of a bundle.
    verified: Verified | None = None

    @property
    def digest(self) -> str:
        """Of the run, or of the sweep."""
        digests = [run.replayed.digest for run in self.runs]
        return digests[0] if self.jobs is None else sweep_digest(dict(zip(self.jobs, digests, strict=True)))


def replay(place: Opened, store: str | None, view: Progress) -> Replay:
    """Run searches and studies again from their stores, and compare every line; of a bundle, all that its records give.

    `store` is where the stores of a directory lie, if they were moved; a bundle has its own.

    Raises:
        DivergenceError: the first difference.
        CacheMissError: a store lacks an answer.
        BundleError: the records of a bundle do not suit each other.
    """
    if place.digest is None:
        runs = rerun_all(place, lambda run: rerun(place.read(run, store), view), view)
        return Replay(jobs=place.jobs, runs=runs)
    if place.root is None:
        return Replay(jobs=place.jobs, runs=(rerun_published(place, place.folder, view),))
    verified = verified_bundle(place, view)
    return Replay(jobs=place.jobs, runs=verified.runs, verified=verified)


def verified_bundle(bundle: Opened, view: Progress) -> Verified:
    """Verify a bundle with the tables of the analysis."""
    from tacevo.api.pages import table_files  # what computes tables takes two seconds to import

    return verify(bundle, partial(table_files, say=view.say), view)
