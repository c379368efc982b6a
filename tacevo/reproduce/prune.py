"""`tacevo cache prune`: the entries of the stores that no run below a directory needs."""

from collections.abc import Sequence
from pathlib import Path

from tacevo.errors import RunError
from tacevo.reproduce.replay import replay
from tacevo.results.run import read_run
from tacevo.results.study_directory import studies_of
from tacevo.runs.progress import Progress
from tacevo.storage.run_directory import runs_below
from tacevo.storage.store import KINDS
from tacevo.studies.study import replay_studies


def unused(root: Path, folders: Sequence[Path], view: Progress) -> tuple[list[Path], int]:
    """List the entries of the stores that no run below these directories reads when it is replayed with its studies.

    A run whose own stores are another directory is passed over. Damaged entries are among those that nobody reads.

    Returns:
        The files, by kind and name, and the number of runs that need others.

    Raises:
        RunError: there is no run; or a run or a study is not finished, so that what it needs is not known.
        CacheMissError: the stores lack an answer of a run.
        DivergenceError: a run is not what its stores give.
    """
    read: set[Path] = set()
    runs = 0
    for path in (path for folder in folders for path in runs_below(folder)):
        recorded = read_run(path)
        if recorded.stores.is_dir() and not recorded.stores.samefile(root):
            view.say(f"{path} has other stores, {recorded.stores}, and is passed over")
            continue
        for study in studies_of(path):
            if study.read().digest is None:
                expected, remedy = "a finished study", "finish it by the same command, or remove its directory"
                raise RunError("one that is not finished", place=str(study.path), expected=expected, remedy=remedy)
        recorded = recorded.with_store(str(root))
        replay(recorded, view, seen=read.add)
        replay_studies(recorded, view, seen=read.add)
        runs += 1
    if not runs:
        place, remedy = ", ".join(map(str, folders)), "name the directories that hold the runs of these stores"
        raise RunError("none", place=place, expected="a run of these stores", remedy=remedy)
    files = (path for kind in KINDS for path in sorted((root / kind).glob("*/*.json")))
    return [path for path in files if path not in read], runs
