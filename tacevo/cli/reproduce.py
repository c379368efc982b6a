"""The commands `tacevo replay` and `tacevo extend`."""

import secrets
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tacevo.api.replaying import digest_of, extended, replay
from tacevo.bundles.deposit import doi_of
from tacevo.bundles.open import Opened, check_walls, opened
from tacevo.bundles.signing import describe_signature
from tacevo.bundles.verify import Rerun, Verified
from tacevo.cli.common import DONE, TO_CITE, existing_store, tell
from tacevo.config.schema import RunConfig
from tacevo.costs import in_words, total
from tacevo.errors import BundleError, ConfigError, DataError
from tacevo.reproduce.retrain import retrain
from tacevo.results.looked_up import with_table
from tacevo.results.settings import found_data, settings_of
from tacevo.results.table_header import is_table
from tacevo.rules import KEPT_SINCE, PAGES
from tacevo.runs.progress import Progress
from tacevo.storage.plan_file import describe_plan
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.text import counted, listed

#: How many draws there are: more than an author can prepare for, and few digits to type again.
_DRAWS = 10**9


def run_replay(
    run: str,
    *,
    store: str | None,
    others: int | None,
    trusts: bool,
    draw: int | None,
    table: str | None,
    allowed: str | None,
) -> int:
    """Replay a run, a sweep, or the table of a space, and train again.

    `others` is the number of networks that are drawn and trained again, 0 for all of them, None for no training.
    """
    path, signers = Path(run), None if allowed is None else Path(allowed)
    if signers is not None and (is_table(path) or not path.is_file()):
        raise ConfigError(run, place="--allowed-signers", expected="a file that `tacevo publish --sign` wrote")
    if is_table(path):
        return _replay_table(path, store, others, draw, table)
    with Progress() as view:
        place = opened(path)
        # Before the replay: who asks for signers need not wait for it.
        signed = []
        if place.digest and path.is_file():
            signed = [describe_signature(path, place.digest, signers)]
            signed += [f"doi: {doi}, as {path.name}.doi says" for doi in [doi_of(path)] if doi]
        if others is not None:
            check_walls(place)
            configs = _with_data_here(path, place, table)
        # The --store of a published run is for the images of --retrain, and need not exist yet.
        done = replay(place, None if place.digest else existing_store(store), view, trusts=trusts)
        told = [*_told(place, done), *_plans(place, done, signers), *signed]
        if others is not None:
            again = [_with_data(*pair) for pair in zip(done.runs, configs, strict=True)]
            told.append(_retrain(again, store, others, draw, view))
    cited = TO_CITE.format("search" if place.jobs is None else "sweep")
    for text in [*told, f"cite:   {cited}", _verdict(done), f"digest: {digest_of(place, done)}"]:
        tell(text)
    return DONE


def _replay_table(path: Path, store: str | None, others: int | None, draw: int | None, named: str | None) -> int:
    """Verify the table of a space."""
    from tacevo.reproduce.space_table import measure_table, retrain_table, verify_table
    from tacevo.results.space_table import read_table

    if named is not None:
        raise ConfigError(named, place="--table", expected=f"no table: {path} is one itself")
    with Progress() as view:
        table = read_table(path)
        verify_table(table)
        told = [table.name, table.failed, measure_table(table, view)]
        if others is not None:
            seed = draw or 1 + secrets.randbelow(_DRAWS)
            told += [retrain_table(one, others or None, seed, store, view) for one in (table, table.judge) if one]
    equal = "EQUAL: every network of the space, with its source, and the seeds; scores by their confusion"
    left = (
        "losses, predictions, weights, failed trainings and the trivial loss are compared by --retrain alone; versions "
        "and machine are not compared"
    )
    for text in [*told, f"{equal}; {left}"]:
        tell(text)
    if table.judge is not None:
        tell(f"judge:  those that the model of the genes puts first, by fresh seeds; its digest: {table.judge.digest}")
    tell(f"cite:   {TO_CITE.format('table')}")
    tell(f"digest: {table.digest}")
    return DONE


def _verdict(done: Verified) -> str:
    """Say in one line what was compared and is equal, and what was not compared."""
    searches, studies = len(done.runs), sum(len(run.studies) for run in done.runs)
    equal = ["search" if searches == 1 else f"{searches} searches"]
    if studies:
        equal.append("1 study" if studies == 1 else f"{studies} studies")
    equal += [f"{counted(done.tables, 'file')} of tables"] if done.tables else []
    older = done.older + sum(run.pages != PAGES for run in done.runs)
    left = [f"{counted(older, 'file')} that another release wrote"] if older else []
    left += [f"{counted(done.unmade, 'file')} of a part that is not installed"] if done.unmade else []
    left += [counted(done.figures, "figure")] if done.figures else []
    why = "" if done.entries is None else " (their checksums hold)"
    return f"EQUAL: {', '.join(equal)}" + (f"; not compared: {listed(left)}{why}" if left else "")


def _told(origin: Opened, done: Verified) -> list[str]:
    """Describe what was compared of each run, and of all runs of a sweep together."""
    runs = done.runs
    lines = sum(run.replayed.lines for run in runs)
    spent = in_words(total(run.replayed.spent for run in runs))
    summary = "costs and summary" if all(run.pages == PAGES for run in runs) else "and costs"
    told = [
        _recomputed(runs),
        f"{lines} ledger lines, both archives, every candidate's source, {summary} are as recorded",
        f"recorded: {spent}; this replay made no call and cost nothing",
    ]
    for job, run in zip(origin.jobs or ("",), runs, strict=True):
        place = f"{job}, " if job else ""
        told += [f"job {job}: digest {run.replayed.digest}"] if job else []
        told += [f"{place}{line}" for line in _decided(run)]
        told += [
            f"{place}study {name}: every score is as recorded, digest {study.digest}"
            for name, study in run.studies.items()
        ]
    studies = [study.record for run in runs if not run.run.has_predictions for study in run.studies.values()]
    if any(study.terms is not None and study.rules >= KEPT_SINCE for study in studies):
        told.append(
            "the bundle of a sweep holds no test predictions: scores are those of the recorded trainings, and of a "
            "classification, accuracy and macro-F1 follow from the confusion; other metrics were not computed again"
        )
    if done.entries is not None:
        told.append(f"all {done.entries} store entries were needed")
        told.append(f"bundle digest: {origin.digest} (of all its files)")
    return told


def _plans(origin: Opened, done: Verified, signers: Path | None) -> list[str]:
    """Say of each study whether it has a plan, and who signed it; that it came first is its author's word."""
    plans = {f"study {name}": study.record.plan for run in done.runs for name, study in run.studies.items()}
    sweep = SweepDirectory(origin.folder)
    if sweep.is_one:
        plans = {"the sweep": sweep.read().terms.plan}  # of which each study is of one job
    told = {what: "none" if plan is None else describe_plan(plan, signers, BundleError) for what, plan in plans.items()}
    return [f"plan of {what}: {said}" for what, said in told.items()]


def _recomputed(runs: Sequence[Rerun]) -> str:
    """Say what was taken from the record, and what was computed here."""
    answers = sum(run.replayed.spent.answers for run in runs)
    models = dict.fromkeys(line.model or run.run.model for run in runs for line in run.run.candidates)
    trainings = sum(line.train_losses is not None for run in runs for line in run.run.candidates)
    trainings += sum(len(study.rows) for run in runs for study in run.studies.values())
    taken = [f"{counted(answers, 'answer')} of {listed(models, most=3)}"] if answers else []
    taken += [counted(trainings, "training")]
    return (
        f"{' and '.join(taken)}, as recorded; every decision and score that follows from them was computed here again"
    )


def _decided(run: Rerun) -> list[str]:
    """Say of each part that the run's user brought what it decided, and whether that was looked at."""
    how = "as its recorded sources decide, confined"
    if not run.replayed.trusted:
        how = "as recorded; --trust-parts lets its recorded sources decide again, confined"
    return [f"{part}: {counted(count, 'decision')}, {how}" for part, count in run.replayed.decisions.items()]


def _with_data_here(path: Path, place: Opened, table: str | None) -> list[RunConfig]:
    """Return the configuration of each run, whose data must be here, with the place of the table that it looked up in.

    It is asked before anything is replayed, which may take long.

    Raises:
        DataError, BundleError: a data set is not there; or as `find_table`.
        ConfigError: a table is named, and no run looked anything up.
    """
    named = None if table is None else Path(table)
    found = []
    for run in place.runs:
        directory = RunDirectory(run)
        record, config = directory.read_run(), settings_of(directory)
        if not (config.data.facts.is_made or config.data.facts.is_looked_up):  # which is found by its digest
            _check_data(directory, record.name, config, in_bundle=place.digest is not None)
        found.append(with_table(config, record.data.fingerprint, path, named, option="--table FILE"))
    if named is not None and all(not config.data.facts.is_looked_up for config in found):
        raise ConfigError(str(table), place="--table", expected="no table: these searches trained")
    return found


def _check_data(directory: RunDirectory, name: str, config: RunConfig, *, in_bundle: bool) -> None:
    """Check that the data set of a recorded run is there.

    Raises:
        DataError: it is not.
    """
    root = found_data(directory, config)
    if root is None or Path(root).exists():
        return
    holds_none, where = (": a bundle holds none", ", or beside the bundle") if in_bundle else ("", "")
    raise DataError(
        f"{root}, which is not there",
        place=f"data.root of {name}",
        expected=f"the data set of the run (data={config.data.source}){holds_none}",
        remedy=f"lay it as {root} into the working directory{where}; without --retrain, nothing needs it",
    )


def _with_data(done: Rerun, config: RunConfig) -> Rerun:
    """Return a run that was run again with the data of another configuration."""
    return replace(done, run=replace(done.run, config=replace(done.run.config, data=config.data)))


def _retrain(runs: Sequence[Rerun], store: str | None, others: int, draw: int | None, view: Progress) -> str:
    """Train candidates of a run or a sweep again; describe what was compared."""
    # Of a published run, the images may lie elsewhere than what it holds.
    recorded = [done.run if store is None else done.run.with_store(store) for done in runs]
    seed = draw or 1 + secrets.randbelow(_DRAWS)  # of this machine: a bundle's own seed is known to its author
    return retrain(recorded, others or None, seed, view)


def run_extend(run: str, overrides: Sequence[str], *, store: str | None, trusts: bool) -> int:
    """Search on from the end of a run."""
    from tacevo.cli.search import paid_now, print_end

    place = opened(Path(run))
    if place.digest is None and store is not None:
        place = replace(place, entries=Path(store))
    with Progress() as view:
        result = extended(place, overrides, view, trusts=trusts)
    print_end(result, paid_now(result))
    return DONE
