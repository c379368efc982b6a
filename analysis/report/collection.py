"""All that is known of a run: its niches, its studies and their comparisons; which tables that gives."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd

from analysis.report.outputs import Outputs, Say, outputs, unsaid
from analysis.runs.niches import Niches, load_niches
from analysis.studies.ceiling import ceiling_of
from analysis.studies.comparison import compare
from analysis.studies.reestimates import Reestimates, load_reestimates
from analysis.studies.searches import LEAST_SEEDS, StudiedSearch
from analysis.table import Table
from analysis.tables.choice import choice_table
from analysis.tables.comparison import study_tables
from analysis.tables.dynamics import (
    costs_table,
    gate_table,
    generations_table,
    improvement_table,
    lineage_table,
    models_table,
    prompts_table,
    temperatures_table,
)
from analysis.tables.niches import niches_table
from analysis.tables.outcome import study_outcome
from analysis.tables.searches import searches_table
from tacevo.errors import CacheMissError, RunError, StoreError, TacevoError
from tacevo.profile import Profile
from tacevo.results.grouped import check_groups, lacks_groups
from tacevo.results.run import RecordedRun, read_run
from tacevo.results.study import RecordedStudy, as_study, is_alone
from tacevo.results.study_directory import FinishedStudy, StudyDirectory, studies_of
from tacevo.text import listed

#: The tables of a run by name, in the order in which an index lists them; of other names, they follow in their own.
_ORDER = (
    *("improvement", "generations", "gate", "prompts", "instruction_effects", "pareto", "temperatures", "models"),
    *("costs", "health", "niches", "lineage"),
)

#: What would have other numbers without re-estimates that were made.
_OF_REESTIMATES = ("table of improvement", "table of pareto", "figure of pareto")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Compared:
    """A finished study and what its comparison says."""

    #: Of its directory.
    name: str
    study: RecordedStudy
    #: As of `compare`; None where it cannot be compared; its scores are shown all the same.
    comparisons: pd.DataFrame | None
    #: Why it cannot be compared; empty where it is.
    uncompared: str = ""
    #: What each output found in it (`tacevo.parts.output.Output.findings`), by the output's name.
    found: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Studies:
    """The finished studies of a run, and what they say of its fitnesses."""

    studies: tuple[Compared, ...]
    #: Of its fitnesses, by its studies and noise runs.
    reestimates: tuple[Reestimates, ...]
    #: Why other studies of the run, or the comparisons of these, are left out, a sentence each.
    left_out: tuple[str, ...]
    #: Why a study, which is there, has no re-estimates: the stores are elsewhere, for example.
    remarks: tuple[str, ...] = ()
    #: Why re-estimates that were made cannot be read, by the study: what rests on them would be other numbers.
    unread: Mapping[str, str] = field(default_factory=dict)
    #: As they were read, also where nothing of them can be shown.
    finished: tuple[FinishedStudy, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Collection(Studies):
    """A run with its studies."""

    run: RecordedRun
    niches: Niches
    #: Studies that are there, and of which nothing is shown (`with_largest_studies`).
    passed_over: tuple[Compared, ...] = ()


def collect(path: Path, store: Path | None = None) -> Collection:
    """Read the directory of a finished run and its studies, with what their test images say; raises as `read_run`.

    `store` is where its stores lie, if not where the run had them.
    """
    run = read_run(path, None if store is None else str(store))
    return collection_of(run, read_studies(run), outputs())


def collection_of(run: RecordedRun, studies: Studies, installed: Outputs | None = None) -> Collection:
    """Return a run with its studies, and what outputs find in them, such as what their test images say.

    These are ours unless others are given: nothing of a stranger's decides what a bundle holds.

    Raises:
        RunError: the niches are not those of the run.
    """
    known = outputs(ours=True) if installed is None else installed
    found = [known.findings(run, one) for one in studies.studies]
    return Collection(
        run=run,
        niches=load_niches(run),
        studies=tuple(replace(one, found=told) for one, (told, _) in zip(studies.studies, found, strict=True)),
        reestimates=studies.reestimates,
        left_out=studies.left_out,
        remarks=(*(missed for _, reasons in found for missed in reasons), *studies.remarks),
        unread=studies.unread,
        finished=studies.finished,
    )


def read_studies(run: RecordedRun) -> Studies:
    """Read the finished studies of a run, without their test images.

    A study that is not finished or has holes is left out, and the reason is kept: the search's own results do not
    depend on it. One that cannot be compared, with too few seeds, say, lacks its comparison only.
    """
    finished, left_out = [], []
    for directory in studies_of(run.path):
        try:
            finished.append(_finished(directory, run))
        except RunError as error:
            left_out.append(_reason(error, run))
    compared = compared_studies(run, finished)
    return replace(compared, left_out=(*left_out, *compared.left_out))


def _reason(error: TacevoError, run: RecordedRun) -> str:
    """Return an error that names files by their place in the run: where that lies is of no interest to a reader."""
    return str(error).replace(f"{run.path}/", "")


def compared_studies(run: RecordedRun, finished: Iterable[FinishedStudy]) -> Studies:
    """Return studies that were read, compared; reasons as in `read_studies`."""
    studies, reestimates, left_out = [], [], []
    remarks: list[str] = []
    unread: dict[str, str] = {}
    known = tuple(finished)
    for one in known:
        if one.record.terms is not None:
            try:
                study = as_study(one)
                ceiling, lacking = ceiling_of(study, run.config), lacks_groups(study, run.config)
                study = replace(study, ceiling=ceiling, lacks_groups=lacking)
            except RunError as error:
                left_out.append(_reason(error, run))
                continue
            comparisons, why = _compared(study)
            studies.append(Compared(name=one.path.name, study=study, comparisons=comparisons, uncompared=why))
            if why and len(study.networks) > 1:  # else that was asked for
                remarks.append(f"the comparison of {one.path}: {why}")
        try:
            reestimates.append(load_reestimates(one, run.config, run.facts.fingerprint, run.stores))
        except (CacheMissError, StoreError) as error:
            unread[one.path.name] = f"no re-estimates by {one.path.name}: {_reason(error, run)}"
        except RunError as error:
            (left_out if one.record.terms is None else remarks).append(f"no re-estimates: {_reason(error, run)}")
    of_noise = [one.path.name for one in known if one.record.is_noise]
    if of_noise and "noise" in (missing := outputs(ours=True).missing):
        remarks.append(f"nothing of {listed(of_noise)}: {missing['noise']}")
    if unread:
        remarks += [*unread.values(), f"no {listed(_OF_REESTIMATES)}, which rest on these re-estimates"]
    return Studies(
        studies=tuple(studies),
        reestimates=tuple(again for again in reestimates if again is not None),
        left_out=tuple(left_out),
        remarks=tuple(remarks),
        unread=unread,
        finished=known,
    )


def _finished(directory: StudyDirectory, run: RecordedRun) -> FinishedStudy:
    finished = directory.read_finished()
    if (studied := finished.record.run) != run.digest:
        raise RunError(
            f"one of its digest {studied[:12]}, before it was continued",
            place=str(directory.path),
            expected=f"a study of the run as it is, of digest {run.digest[:12]}",
            remedy="study it again",
        )
    check_groups(finished.record, run.facts, run.config, f"{directory.path}/study.json")
    return finished


def _compared(study: RecordedStudy) -> tuple[pd.DataFrame | None, str]:
    """Compare a study; where that fails, return the reason."""
    try:
        return compare(study), ""
    except RunError as error:
        return None, str(error)


def with_largest_studies(collection: Collection) -> Collection:
    """Keep a run's largest study on each data set: the most epochs, then seeds, then networks; never by results.

    Of equal ones that counts which trained as the run, then which records the groups of its images. The study on the
    run's data comes first.
    """
    ordered = sorted(collection.studies, key=_size)
    largest = {one.study.fingerprint: one for one in ordered}
    kept = sorted(largest.values(), key=lambda one: (bool(one.study.other_data), one.name))
    passed_over = tuple(one for one in ordered if one is not largest[one.study.fingerprint])
    left = {one.name for one in passed_over}
    return replace(
        collection,
        studies=tuple(kept),
        passed_over=passed_over,
        reestimates=tuple(one for one in collection.reestimates if one.name not in left),
    )


def _size(one: Compared) -> tuple[int, int, int, bool, bool, str]:
    study = one.study
    size = study.recipe.epochs, study.seeds, len(study.networks)
    return *size, not study.other_device, not study.lacks_groups, one.name


def side_by_side(collections: Sequence[Collection]) -> tuple[list[Table], list[str]]:
    """Return tables of the runs that search one task, and which of these they lack, with the reason.

    Runs stand beside each other by studies that are alike, where a fitness is the same of equal numbers of epochs. The
    re-estimates that choose are always those of the study on the run's own data; on other data, exactly the same
    networks must have been studied.
    """
    alike: dict[tuple[object, ...], list[StudiedSearch]] = {}
    for one in collections:
        studies = {compared.name for compared in one.studies}  # a noise run is none
        known_of = {known.networks: known for known in one.reestimates if known.name in studies}
        for compared in one.studies:
            study, known = compared.study, known_of.get(compared.study.networks)
            if known is None or compared.comparisons is None or min(study.seeds, known.seeds) < LEAST_SEEDS:
                continue
            trained = study.recipe, study.numerics, study.device, study.seeds
            likeness = study.task, known.epochs, known.rule, study.fingerprint, trained
            searches = alike.setdefault(likeness, [])
            if all(other.study.run != study.run for other in searches):
                searches.append(StudiedSearch(name=one.run.name, study=study, reestimates=known))
    groups = [searches for searches in alike.values() if len(searches) > 1]
    shown = {search.name for searches in groups for search in searches}
    tasks = Counter(one.run.task for one in collections)
    alone = [
        f"{one.run.name} is not beside the other runs of {one.run.task}: expected another search of as many epochs, by "
        f"the same training.fitness; a study of each on the run's data; and of both, studies of equal epochs and "
        f"seeds, {LEAST_SEEDS} or more"
        for one in collections
        if tasks[one.run.task] > 1 and one.run.name not in shown
    ]
    return _numbered(map(searches_table, groups)), alone


def _numbered(tables: Iterable[Table]) -> list[Table]:
    """Number the tables that have one name, from the second."""
    known: Counter[str] = Counter()
    numbered = []
    for table in tables:
        known[table.name] += 1
        number = known[table.name]
        numbered.append(table if number == 1 else replace(table, name=f"{table.name}_{number}"))
    return numbered


def outcomes(run: RecordedRun, whole: Studies) -> dict[str, Table]:
    """Return what each study, choice and noise run of a run found in short, by the name of its directory.

    Where the output of noise is not installed, noise runs are left out.
    """
    again = {one.name: one for one in whole.reestimates}
    studies = [one.study for one in whole.studies]
    tables = {
        one.name: study_outcome(
            one.study,
            one.comparisons,
            again.get(one.name),
            trivial=run.record.trivial,
            is_alone=is_alone(one.study, studies),
        )
        for one in whole.studies
    } | {one.path.name: choice_table(one) for one in whole.finished if one.record.is_choice}
    of_noise = {name: one for name, one in again.items() if name not in tables}
    if not of_noise or "noise" in outputs(ours=True).missing:
        return tables
    from analysis.tables.noise_outcome import noise_outcome  # of an output, which may be missing

    return tables | {name: noise_outcome(one, run.task, run.record.trivial) for name, one in of_noise.items()}


def tables_of(
    collection: Collection,
    profiles: Mapping[str, Profile] | None,
    installed: Outputs | None = None,
    say: Say = unsaid,
) -> tuple[Table, ...]:
    """Return every table of a run and its studies; the names of a study's tables begin with its own.

    Without the profiles of its trained candidates, by id, there is no table of motifs. Of installed outputs there are
    those of ours unless others are given; what is missing of them, who calls must say. `say` is called with a sentence
    on what others cannot make.
    """
    known = outputs(ours=True) if installed is None else installed
    run = collection.run
    tables = [] if collection.unread else [improvement_table(run, collection.reestimates)]
    tables += [generations_table(run, collection.niches.networks), gate_table(run), prompts_table(run)]
    tables += [temperatures_table(run), costs_table(run), niches_table(run, collection.niches)]
    if run.config.llm.models is not None:
        tables.append(models_table(run))
    if run.elites:
        tables.append(lineage_table(run, run.ranked()[0].id))
    tables += known.tables(collection, profiles, say)
    tables.sort(key=lambda table: _ORDER.index(table.name) if table.name in _ORDER else len(_ORDER))
    everywhere = [compared.study for compared in (*collection.studies, *collection.passed_over)]
    for compared in collection.studies:
        of_study = [
            *study_tables(compared.study, compared.comparisons, is_alone=is_alone(compared.study, everywhere)),
            *known.study_tables(collection, compared, say),
        ]
        tables += [_of_study(table, compared) for table in of_study]
    for choice in collection.finished:
        if choice.record.is_choice:
            tables.append(replace(choice_table(choice), name=f"{choice.path.name}/choice"))
    for one in collection.reestimates:
        of_noise = known.reestimate_tables(collection, one, say)
        tables += [replace(table, name=f"{one.name}/{table.name}") for table in of_noise]
    return tuple(tables)


def _of_study(table: Table, compared: Compared) -> Table:
    """Name a table after its study; caption and a note tell of other settings: the same networks may stand beside."""
    named = replace(table, name=f"{compared.name}/{table.name}")
    where = compared.study.apart
    if not where or table.name.startswith("transfer"):
        return named
    what = "on other data" if compared.study.other_data else "trained with other settings"
    notes = table.notes if any(where in note for note in table.notes) else (where, *table.notes)
    return replace(named, caption=f"{table.caption.removesuffix('.')}, {what} than the run's.", notes=notes)
