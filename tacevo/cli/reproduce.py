"""The command `tacevo replay`; what it does is imported when it runs, so that help is quick."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tacevo.cli.common import DIFFERENT, DONE, OVERRIDE, Parser, existing_store
from tacevo.cli.publish import in_bundle, verify_bundle
from tacevo.text import printable

if TYPE_CHECKING:
    from tacevo.bundles.open import Opened
    from tacevo.bundles.verify import Rerun
    from tacevo.runs.progress import View

if TYPE_CHECKING:
    from tacevo.bundles.open import Opened
    from tacevo.runs.progress import View


#: What `--retrain` without a number stands for.
_ALL = 0


def add_replay(commands: "argparse._SubParsersAction[Parser]") -> None:
    """Describe `tacevo replay`."""
    replay = commands.add_parser(
        "replay",
        help="run a recorded search again from its stores and compare",
        description="Run a recorded search and its finished studies again, without model, training or data set, and "
        "compare every line; of a sweep, every search. With --retrain, train the candidates again, too. A published "
        "run or sweep is replayed from what it holds, with every table. With --diff, run nothing again, and hold the "
        "run against another one.",
    )
    replay.add_argument(
        "run", metavar="RUN", help="the folder of a run or a sweep, or a file that `tacevo publish` wrote"
    )
    replay.add_argument(
        "--store",
        metavar="DIR",
        help="where its stores lie, if they were moved; for a published run, where --retrain keeps images",
    )
    replay.add_argument(
        "--retrain",
        nargs="?",
        type=_count,
        const=_ALL,
        metavar="N",
        help="then train the candidates again, or N of them drawn by the run's seed, and compare every bit",
    )
    replay.add_argument("--diff", metavar="OTHER", help="say where this run and another one part; 1 is the status then")
    replay.set_defaults(command=_replay)


def _replay(options: argparse.Namespace) -> int:
    if options.diff is not None:
        return _diff(options)
    from rich.console import Console

    from tacevo.bundles.open import opened
    from tacevo.runs.progress import PlainView

    with opened(Path(options.run)) as found, PlainView(Console(stderr=True)) as view:
        if options.retrain is not None:
            from tacevo.bundles.open import insist_on_walls

            insist_on_walls(found)
        if found.root is None:
            runs, beside = _rerun(found, existing_store(options.store), view), []
        else:  # its --store is for the images of --retrain, and may be a folder that is yet to be made
            verified = verify_bundle(found, view)
            runs = verified.runs
            beside = [in_bundle(verified), f"bundle digest: {found.digest}"]
        trained = [] if options.retrain is None else [_retrain(runs, options, view)]
    for text in [*_told(found, runs), *beside, *trained, f"digest: {_digest(found, runs)}"]:
        print(printable(text))
    return DONE


def _rerun(found: "Opened", store: str | None, view: "View") -> tuple["Rerun", ...]:
    """Run every search and study of a folder again; compare a sweep's list of jobs with them."""
    from tacevo.bundles.open import over_runs
    from tacevo.bundles.verify import rerun
    from tacevo.config.recorded import read_recorded
    from tacevo.storage.sweep_directory import SweepDirectory
    from tacevo.sweeps.check import check_jobs

    runs = over_runs(found, lambda run: rerun(read_recorded(run, store), view), view.say)
    if found.jobs is not None:
        check_jobs(SweepDirectory(found.folder))
    return runs


def _told(found: "Opened", runs: Sequence["Rerun"]) -> list[str]:
    """Say what was compared of each run, and of a sweep of all together, for a person."""
    from tacevo.costs import in_words, total
    from tacevo.rules import PAGES

    lines = sum(run.replayed.lines for run in runs)
    spent = in_words(total(run.replayed.spent for run in runs))
    summary = "costs and summary" if all(run.pages == PAGES for run in runs) else "and costs"
    told = [
        f"{lines} ledger lines, both archives, every candidate's source, {summary} are as recorded",
        f"recorded: {spent}; this replay made no call and cost nothing",
    ]
    for job, run in zip(found.jobs or ("",), runs, strict=True):
        place = f"{job}, " if job else ""
        told += [f"job {job}: digest {run.replayed.digest}"] if job else []
        told += [
            f"{place}study {name}: every score is as recorded, digest {digest}" for name, digest in run.studies.items()
        ]
    return told


def _digest(found: "Opened", runs: Sequence["Rerun"]) -> str:
    """Give the digest of a run, or of a sweep."""
    from tacevo.storage.sweep_directory import sweep_digest

    digests = [run.replayed.digest for run in runs]
    return digests[0] if found.jobs is None else sweep_digest(dict(zip(found.jobs, digests, strict=True)))


def _diff(options: argparse.Namespace) -> int:
    """Hold two runs against each other."""
    if options.retrain is not None or options.store is not None:
        options.parser.error("--diff reads what two runs recorded; it takes neither --retrain nor --store")
    from tacevo.bundles.open import opened
    from tacevo.reproduce.compare import compare, describe, read_compared

    with opened(Path(options.run)) as one, opened(Path(options.diff)) as other:
        remedy = "give the folders of two runs, of a sweep those of two jobs (a published one is unpacked for that)"
        found = compare(read_compared(one.one_run(remedy)), read_compared(other.one_run(remedy)))
    print(printable(describe(found)))
    return DONE if found.is_equal else DIFFERENT


def _retrain(runs: Sequence["Rerun"], options: argparse.Namespace, view: "View") -> str:
    """Train candidates of a run or a sweep again; say what was compared."""
    from tacevo.reproduce.retrain import describe, retrain

    store = options.store  # of a published run, the images may lie elsewhere than what it holds
    recorded = [done.run if store is None else done.run.with_store(store) for done in runs]
    return describe(retrain(recorded, options.retrain or None, view))


def _count(text: str) -> int:
    """Read the number of evaluations to train again."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a number of evaluations >= 1; got {text!r}")
    return int(text)


def add_continue(commands: "argparse._SubParsersAction[Parser]") -> None:
    """Describe `tacevo continue`."""
    command = commands.add_parser(
        "continue",
        help="take up a published run where it ended",
        description="Replay a finished run, and search on from its end in a run directory of its own, whose ledger "
        "begins with the very lines of the published one. The published run and its stores are only read.",
    )
    command.add_argument("run", metavar="RUN", help="the folder of a run, or a file that `tacevo publish` wrote")
    command.add_argument("overrides", nargs="*", metavar="OVERRIDE", help=f"{OVERRIDE}; search.generations=N is needed")
    command.add_argument(
        "--rules",
        choices=["current"],
        help="search on under this release's rules where the run has others; the ledger records the change",
    )
    command.add_argument("--store", metavar="DIR", help="where its stores lie, if they were moved")
    command.set_defaults(command=_continue)


def _continue(options: argparse.Namespace) -> int:
    from dataclasses import replace

    from rich.console import Console

    from tacevo.bundles.extend import continue_run
    from tacevo.bundles.open import opened
    from tacevo.runs.progress import PlainView

    with opened(Path(options.run)) as found, PlainView(Console(stderr=True)) as view:
        moved = found.root is None and options.store is not None
        published = replace(found, store=Path(options.store)) if moved else found
        mix = options.rules is not None
        result = continue_run(published, options.overrides, view, check=lambda run: _checked(run, view), mix_rules=mix)
    print(result.summary)
    print(f"run: {result.directory}")
    print(f"digest: {result.digest}")
    return DONE


def _checked(published: "Opened", view: "View") -> set[Path]:
    """Replay a run, and of a bundle verify all of it; give the store entries that it needs."""
    from tacevo.config.recorded import read_recorded
    from tacevo.reproduce.replay import replay

    if published.root is not None:
        verify_bundle(published, view)
        return set(published.store.rglob("*.json"))
    read: set[Path] = set()
    replay(read_recorded(published.folder, str(published.store)), view, seen=read.add)
    return read
