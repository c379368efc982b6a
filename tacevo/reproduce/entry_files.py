"""`tacevo cache export | import`: the entries that a run needs, as one file, and back into a store.

The file is that of a bundle's store (`tacevo.storage.entries`). What an import promises: every entry is verified before
the first one is written, and none is written outside the stores or over a different answer.
"""

from pathlib import Path

from tacevo.reproduce.replay import replay
from tacevo.results.run import read_run
from tacevo.runs.progress import Progress
from tacevo.storage.array_store import KIND
from tacevo.storage.entries import CANDIDATES, ReadBudget, pack, unpack
from tacevo.storage.files import write_durably
from tacevo.storage.listing import take_in
from tacevo.storage.store import read_entry
from tacevo.studies.study import replay_studies


def write_entries(run: Path, target: Path, store: str | None, view: Progress) -> int:
    """Write the entries that a replay of a run and its finished studies reads into one file; return their number.

    A file that stands at `target` is replaced. `store` is where the stores lie, if not where the run had them.

    Raises:
        DivergenceError: the run is not what its stores give.
        CacheMissError: a store lacks an answer.
        RunError: this is not a finished run.
    """
    read: set[Path] = set()
    recorded = read_run(run, store)
    replay(recorded, view, seen=read.add)
    replay_studies(recorded, view, seen=read.add)
    write_durably(target, pack(map(read_entry, read)))
    return len(read)


def import_file(source: Path, root: Path) -> tuple[int, int, int]:
    """Write the entries of an exported file, or of a bundle's store, into the stores.

    Of a published sweep's, candidates' files are passed over, and full trainings, whose test predictions it lacks: a
    store that has one without the other cannot study.

    Returns:
        The number of entries that were written, of those that stood there already, and of those passed over.

    Raises:
        StoreError: the file, an entry or a place in the stores is not as it should be; nothing was written.
    """
    entries = list(unpack(source, ReadBudget(source, source.stat().st_size)))
    kinds = {entry.kind for entry in entries}
    left = {CANDIDATES, "studies"} if CANDIDATES in kinds and KIND not in kinds else {CANDIDATES}
    taken = [entry for entry in entries if entry.kind not in left]
    return *take_in(source, taken, root), len(entries) - len(taken)
