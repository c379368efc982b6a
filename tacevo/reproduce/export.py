"""`tacevo cache export | import`: the entries that a run needs, as one file, and back into a store.

The file is that of a bundle's store (`tacevo.storage.entries`). What an import promises: every entry is verified before
the first one is written, and none is written outside the stores or over a different answer.
"""

from pathlib import Path

from tacevo.config.recorded import read_recorded
from tacevo.reproduce.replay import replay
from tacevo.runs.progress import Progress
from tacevo.storage.entries import CANDIDATES, Budget, pack, unpack
from tacevo.storage.files import write_durably
from tacevo.storage.listing import take_in
from tacevo.storage.store import read_entry
from tacevo.studies.study import replay_studies


def export(run: Path, target: Path, store: str | None, view: Progress) -> int:
    """Write the entries that a replay of a run and its finished studies reads into one file; return their number.

    A file that stands at `target` is replaced. `store` is where the stores lie, if not where the run had them.

    Raises:
        DivergenceError: the run is not what its stores give.
        CacheMissError: a store lacks an answer.
        RunError: this is not a finished run.
    """
    read: set[Path] = set()
    recorded = read_recorded(run, store)
    replay(recorded, view, seen=read.add)
    replay_studies(recorded, view, seen=read.add)
    write_durably(target, pack(map(read_entry, read)))
    return len(read)


def import_file(source: Path, root: Path) -> tuple[int, int]:
    """Write the entries of an exported file, or a bundle's store, into the stores; candidates' files are passed over.

    Returns:
        The number of entries that were written, and of those that stood there already.

    Raises:
        StoreError: the file, an entry or a place in the stores is not as it should be; nothing was written.
    """
    found = unpack(source, Budget(source, source.stat().st_size))
    return take_in(source, (entry for entry in found if entry.kind != CANDIDATES), root)
