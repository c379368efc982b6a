"""The commands `tacevo replay` and `tacevo continue`."""

import argparse
import secrets
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tacevo.api.replaying import replay, verified_bundle
from tacevo.bundles.open import Opened, check_walls, opened
from tacevo.bundles.verify import Rerun, Verified, rerun_published
from tacevo.cli.common import DIFFERENT, DONE, OVERRIDE, RUN, Parser, existing_store, whole_number
from tacevo.costs import in_words, total
from tacevo.reproduce.compare import compare
from tacevo.reproduce.replay import replay as replay_search
from tacevo.reproduce.retrain import retrain
from tacevo.results.run import read_run
from tacevo.rules import KEPT_SINCE, PAGES
from tacevo.runs.progress import Progress
from tacevo.text import printable

#: How many draws there are: more than an author can prepare for, and few digits to type again.
_DRAWS = 10**9

#: What `--retrain` without a number stands for.
_ALL = 0


def add_replay(parser: Parser) -> None:
    """Describe `tacevo replay`."""
    parser.description = (
        "Run a recorded search and its finished studies again, without model, training or data set, and compare every "
        "line; of a sweep, every search. With --retrain, also train the candidates again. A published run or sweep is "
        "replayed from its own records, with every table. With --diff, run nothing again, and compare the run with "
        "another one."
    )
    parser.add_argument(
        "run",
        metavar="RUN",
        help="the directory of a run or a sweep, or a file that `tacevo publish` wrote; SWEEP.zip/JOB is one run of it",
    )
    parser.add_argument(
        "--store",
        metavar="DIR",
        help="the directory of its stores, if they were moved; for a published run, where --retrain keeps images",
    )
    parser.add_argument(
        "--retrain",
        nargs="?",
        type=whole_number,
        const=_ALL,
        metavar="N",
        help="then train the candidates again and compare every bit; with N the best network, the networks of studies, "
        "and N others that are drawn at random",
    )
    parser.add_argument(
        "--draw", type=whole_number, metavar="SEED", help="draw the N as an earlier replay did, which told its seed"
    )
    parser.add_argument("--diff", metavar="OTHER", help="compare with another run; the exit status is 1 if they differ")
    parser.set_defaults(command=_replay)


def _replay(options: argparse.Namespace) -> int:
    if options.draw is not None and not options.retrain:
        options.parser.error("--draw repeats the draw of --retrain N; give both")
    if options.diff is not None:
        return _diff(options)

    found = opened(Path(options.run))
    with Progress() as view:
        if options.retrain is not None:
            check_walls(found)
        beside: list[str] = []
        # The --store of a published run is for the images of --retrain, and need not exist yet.
        done = replay(found, None if found.digest else existing_store(options.store), view)
        runs = done.runs
        if done.verified is not None:
            beside = [_in_bundle(done.verified), f"bundle digest: {found.digest}"]
        trained = [] if options.retrain is None else [_retrain(runs, options, view)]
    for text in [*_told(found, runs), *beside, *trained, f"digest: {done.digest}"]:
        print(printable(text))
    return DONE


def _in_bundle(verified: Verified) -> str:
    """Describe what of a bundle was compared beside its search and studies."""
    if all(run.pages == PAGES for run in verified.runs):
        pages = f"summary, costs and {verified.tables} files of tables follow from the records, byte for byte"
    else:
        pages = (
            "costs follow from the records; summary and tables were written by another release, so only their "
            "checksums were compared, and `tacevo tables` writes today's"
        )
    return (
        f"{pages}; all {verified.entries} store entries were needed\n"
        f"{verified.figures} figures and the pages that describe the bundle: their checksums are right, nothing else "
        "was compared"
    )


def _told(found: Opened, runs: Sequence[Rerun]) -> list[str]:
    """Describe what was compared of each run, and of all runs of a sweep together."""
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
            f"{place}study {name}: every score is as recorded, digest {study.scores.digest}"
            for name, study in run.studies.items()
        ]
    studies = [study.record for run in runs if not run.run.has_predictions for study in run.studies.values()]
    if any(study.terms is not None and study.rules >= KEPT_SINCE for study in studies):
        told.append(
            "the bundle of a sweep holds no test predictions: scores are those of the recorded trainings, and of a "
            "classification, accuracy and macro-F1 follow from the confusion; other metrics were not computed again"
        )
    return told


def _diff(options: argparse.Namespace) -> int:
    """Compare two runs."""
    if options.retrain is not None or options.store is not None:
        options.parser.error("--diff reads what two runs recorded; it takes neither --retrain nor --store")

    one = opened(Path(options.run))
    other = opened(Path(options.diff))
    remedy = "name the directories of two runs, of a sweep those of two jobs (of a published one SWEEP.zip/JOB)"
    is_equal, said = compare(*(read_run(each.one_run(remedy)) for each in (one, other)))
    print(printable(said))
    return DONE if is_equal else DIFFERENT


def _retrain(runs: Sequence[Rerun], options: argparse.Namespace, view: Progress) -> str:
    """Train candidates of a run or a sweep again; describe what was compared."""
    store = options.store  # of a published run, the images may lie elsewhere than what it holds
    recorded = [done.run if store is None else done.run.with_store(store) for done in runs]
    draw = options.draw or 1 + secrets.randbelow(_DRAWS)  # of this machine: a bundle's own seed is known to its author
    return retrain(recorded, options.retrain or None, draw, view)


def add_continue(parser: Parser) -> None:
    """Describe `tacevo continue`."""
    parser.description = (
        "Replay a finished run, and search on from its end in a new run directory, whose ledger begins with the lines "
        "of the published one. The published run and its stores are only read."
    )
    parser.add_argument("run", metavar="RUN", help=RUN)
    parser.add_argument(
        "overrides", nargs="*", metavar="OVERRIDE", help=f"{OVERRIDE}; a larger search.generations is needed"
    )
    parser.add_argument("--store", metavar="DIR", help="the directory of its stores, if they were moved")
    parser.set_defaults(command=_continue)


def _continue(options: argparse.Namespace) -> int:
    from tacevo.bundles.extend import continue_run  # imports Hydra, which a replay does not need
    from tacevo.cli.search import print_end

    found = opened(Path(options.run))
    with Progress() as view:
        moved = found.digest is None and options.store is not None
        published = replace(found, entries=Path(options.store)) if moved else found
        result = continue_run(published, options.overrides, view, check=lambda run: _checked(run, view))
    print_end(result)
    return DONE


def _checked(published: Opened, view: Progress) -> set[Path]:
    """Replay a run, and of a bundle verify all of it; return the store entries that it needs."""
    if published.root is not None:
        verified_bundle(published, view)
        return set(published.store.glob("*/*/*.json"))
    read: set[Path] = set()
    if published.digest is not None:  # compares its studies, too, whose entries a search does not need
        rerun_published(published, published.folder, view)
    replay_search(published.read(published.folder), view, seen=read.add)
    return read
