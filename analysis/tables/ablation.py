"""The tables of a sweep: all arms in all metrics, each metric against the reference, and every run."""

import json
from collections.abc import Callable, Collection, Sequence
from statistics import median

import pandas as pd

from analysis.rounding import shown
from analysis.statistics.effects import LEVEL, RESAMPLES, median_confidence
from analysis.studies.warnings import caution_notes, power_note
from analysis.sweeps.ablation import FEWEST_SEEDS, Ablation, Comparability
from analysis.sweeps.arm_metrics import FRACTIONS, LESS_IS_BETTER, SPENT, TESTED, TESTS, Metric
from analysis.table import Cell, HalfInteger, Layout, Percent, PValue, Table, interval_cell, percent_interval_cell
from analysis.tables.comparison import EFFECTS_LAYOUT, scaled
from analysis.tables.followed_plan import plan_notes
from analysis.tables.grammar_note import carrier_notes, grammar_note
from tacevo.choices import ChosenBy
from tacevo.config.identity import twins_of
from tacevo.evolution.chance import is_at_chance
from tacevo.records import Json, Kind
from tacevo.results.study import LOSS, PRIMARY
from tacevo.results.sweep import ALPHA, REFERENCE, FinishedJob, RecordedSweep
from tacevo.results.sweep_checks import arm_settings
from tacevo.rounding import rounded
from tacevo.storage.canonical import leaves
from tacevo.text import assignments, counted, listed

#: The columns of a median with its interval.
_ENDS = ("median", "median_low", "median_high")

#: What the network that a job found is best by.
_CHOSEN = {
    ChosenBy.fitness: "the best fitness",
    ChosenBy.reestimated: "the best median fitness in a noise run",
    ChosenBy.validated: "the lowest validation loss in one training as long, with a seed that does not test",
}

#: Said of what answers cost.
_SHARED = "Arms share recorded answers, so that a sweep paid less than the sum of its runs."

#: What a metric counts, where its name does not say it.
_MEANINGS = {
    **dict.fromkeys(
        TESTS.values(),
        "Of the best network that a run found, or of the stated number of best ones, the baseline among them, trained "
        "again with fresh seeds and tested: the median over these seeds, mean over the networks.",
    ),
    Metric.test_loss: "Of the same trainings, the geometric mean over seeds and networks of the loss on the test "
    "images: cross-entropy (nats) of classes, MSE of values. All seeds count in it, and how sure a network is.",
    Metric.best_fitness: "Fitness is a validation loss in the units of training.",
    Metric.new_quartile: "The fitness that a quarter of the new candidates of the later half of the generations reach; "
    "a slot without a network that trains is worse than any. Each is a draw of its own, so no luck piles up in it.",
    Metric.new_median: "The fitness that half of these candidates reach.",
    Metric.improvement: "The part of generation 0's best fitness that is gone at the end.",
    Metric.improvement_over_baseline: "The part of the baseline's fitness that is gone at the end.",
    Metric.trainable: "First answers that were trained, mean over the generations from 1 on.",
    Metric.candidates: "Slots of all generations that asked for a network, and the baseline.",
    Metric.evaluations: "Trainings of different sources and seeds, failed ones among them.",
    Metric.training_flops: "Forward FLOPs of one image x images x epochs, of different sources and seeds that were "
    "trained to the end; the backward pass, about twice as much again, is not counted.",
    Metric.tokens: f"Read and written, of all answers. {_SHARED}",
    Metric.cost: f"Of all answers, by the prices recorded with them. {_SHARED}",
}


def ablation_tables(sweep: RecordedSweep, ablation: Ablation, archive: str) -> tuple[Table, ...]:
    """Return all tables of a sweep.

    `archive` is what is to be said of the common archive. Where nothing cost anything, no table compares costs.
    """
    is_free = ablation.jobs[Metric.cost.name].eq(0).all()
    compared = [metric for metric in ablation.arms if not (is_free and metric is Metric.cost)]
    return (
        arms_table(sweep, ablation, archive),
        settings_table(sweep),
        *(metric_table(sweep, ablation, metric, archive) for metric in compared),
        runs_table(sweep, ablation, archive),
    )


def arms_table(sweep: RecordedSweep, ablation: Ablation, archive: str) -> Table:
    """Show every arm in every metric: median and interval."""
    first = next(iter(ablation.arms))
    trivial = [_trivial(sweep, metric) for metric in ablation.arms]
    equal_to = (
        {Comparability.by_construction: ablation.requested_reference}
        if twins_of(ablation.requested_reference, ablation.twins)
        else {}
    )
    return Table.of(
        pd.concat({metric.name: frame.reset_index() for metric, frame in ablation.arms.items()}, axis=1),
        {
            "arm": (str, (first.name, "arm")),
            "seeds": (int, (first.name, "runs")),
            **({"equal to": (equal_to.get, (first.name, "comparability"))} if equal_to else {}),
            **{metric.value: (_shape(metric), *((metric.name, end) for end in _ENDS)) for metric in ablation.arms},
        },
        name="ablation",
        caption=f"The arms ({sweep.task}).",
        last=[("trivial", None, *([None] if equal_to else []), *trivial)] if trivial[0] is not None else [],
        notes=(
            *_primary_note(sweep, ablation),
            *_twin_notes(ablation),
            *temperature_notes(sweep),
            *_tested_notes(sweep),
            *plan_notes(sweep.terms.plan),
            *_trivial_note(sweep, first),
            _median_note([n for frame in ablation.arms.values() for n in frame.n]),
            archive,
            *(
                f"{metric.value}: {words[0].lower()}{words[1:]}"
                for metric, words in _MEANINGS.items()
                if metric in ablation.arms
            ),
            *_reference_note(sweep, ablation),
            *_chance_note(sweep),
            *_missing_note(sweep),
            *_failed_note(sweep, first),
        ),
    )


def _chance_note(sweep: RecordedSweep) -> list[str]:
    """Say in which jobs nothing was learned."""
    at_chance = [one for one in sweep.finished if is_at_chance(one.run.generations[-1].best, one.run.record.trivial)]
    if not at_chance:
        return []
    jobs, names = counted(len(sweep.finished), "finished job"), ", ".join(one.job.name for one in at_chance)
    return [f"At chance: {len(at_chance)} of {jobs}; their best networks are hardly below the trivial loss: {names}."]


def settings_table(sweep: RecordedSweep) -> Table:
    """Show the settings in which the recorded configurations of the arms differ."""
    arms = {one.job.arm: _settings(one) for one in reversed(sweep.finished)}
    names = list(dict.fromkeys(one.job.arm for one in sweep.finished))
    keys = dict.fromkeys(key for name in names for key in arms[name])
    differing = [key for key in keys if len({json.dumps(arms[name].get(key)) for name in names}) > 1]
    return Table(
        name="ablation_settings",
        caption=f"The settings in which the arms differ ({sweep.task}).",
        columns=("setting", *names),
        rows=tuple(
            (key, *(value if isinstance(value := arms[name].get(key), str) else json.dumps(value) for name in names))
            for key in differing
        ),
        notes=(
            "As the runs recorded them; all other settings that may change a result are equal.",
            *temperature_notes(sweep),
        ),
    )


def _settings(one: FinishedJob) -> dict[str, Json]:
    """Return the settings of an arm by key; what carries its temperatures also where a record leaves it out."""
    return {"temperature.carrier": one.run.carrier, **dict(leaves(arm_settings(one)))}


def metric_table(sweep: RecordedSweep, ablation: Ablation, metric: Metric, archive: str) -> Table:
    """Show every arm in one metric, and how it differs from the reference."""
    trivial, frame = _trivial(sweep, metric), ablation.arms[metric]
    layout = _layout(metric)
    return Table.of(
        frame.reset_index(),
        layout,
        name=f"ablation_{metric.name}",
        kind="ablation_primary" if metric is ablation.primary else "ablation_metric",
        caption=f"The arms ({sweep.task}): {metric.value}.",
        last=[("trivial", None, trivial, *(None,) * (len(layout) - 3))] if trivial is not None else [],
        notes=(
            *_rank_note(sweep, ablation, metric),
            *(_tested_notes(sweep) if metric in TESTED else []),
            *_trivial_note(sweep, metric),
            *([_MEANINGS[metric]] if metric in _MEANINGS else []),
            *([archive] if metric in {Metric.qd_score, Metric.coverage} else []),
            f"{'Less' if metric in LESS_IS_BETTER else 'More'} is better.",
            *temperature_notes(sweep),
            _median_note(list(frame.n), list(frame[["better", "equal", "worse"]].sum(axis=1)[frame.better.notna()])),
            *_test_notes(ablation, metric),
            *_reference_note(sweep, ablation),
            *_missing_note(sweep),
            *_failed_note(sweep, metric),
        ),
    )


def runs_table(sweep: RecordedSweep, ablation: Ablation, archive: str) -> Table:
    """Show every run in every metric."""
    shapes = {metric.value: (Percent, metric.name) if metric in FRACTIONS else metric.name for metric in ablation.arms}
    return Table.of(
        ablation.jobs.reset_index(),
        {"run": "job", "arm": "arm", "seed": "seed", **shapes},
        name="ablation_runs",
        caption=f"The runs ({sweep.task}).",
        notes=(archive, *_missing_note(sweep)),
    )


def _shape(metric: Metric) -> Callable[..., Cell]:
    return percent_interval_cell if metric in FRACTIONS else interval_cell


def _layout(metric: Metric) -> Layout:
    """Lay out the arms in one metric; a word stands where there is no p."""
    unit, factor = (" (percentage points)", 100) if metric in FRACTIONS else ("", 1)
    return {
        "arm": "arm",
        "seeds": "n",
        "median": (_shape(metric), *_ENDS),
        "runs that differ": "differing",
        "U": (HalfInteger, "u"),
        "p": (lambda word, p: word if p is None else PValue(p), "comparability", "p"),
        "p, Holm": (PValue, "p_holm"),
        "method": "method",
        **EFFECTS_LAYOUT,
        f"difference of medians{unit}": scaled("difference", factor),
        f"median difference by seed{unit}": scaled("by_seed", factor),
        **{f"seeds {word}": word for word in ("better", "equal", "worse")},
    }


def _trivial(sweep: RecordedSweep, metric: Metric) -> Cell:
    """Return the trivial predictor's score: the median over the jobs, whose data may follow from their seeds."""
    tests = [one.tested for one in sweep.finished if one.tested is not None]
    name = {Metric.test_loss: LOSS}.get(metric, PRIMARY)[sweep.finished[0].run.facts.kind]
    scores = [one.trivial[name] for one in tests if name in one.trivial]
    if not scores or metric not in TESTED:
        return None
    return Percent(rounded(median(scores))) if metric in FRACTIONS else rounded(median(scores))


def _trivial_note(sweep: RecordedSweep, metric: Metric) -> list[str]:
    is_regression = sweep.finished[0].run.facts.kind is Kind.regression
    always = "mean" if is_regression else "most frequent class (for a cross-entropy, the frequencies of all)"
    words = f"Trivial: looks at no image, and always predicts the {always} of the test images."
    return [] if _trivial(sweep, metric) is None else [words]


def _median_note(counts: Collection[int], pairs: Collection[int] = ()) -> str:
    """Explain the intervals of medians, by the numbers of known values and of differences by seed."""
    words = (
        "Median over the seeds whose value is known; in brackets two of their values, equally far from either end. The "
        f"median of all seeds lies between them with a chance of {100 * LEVEL:g} % at least"
    )
    weak = [n for n in sorted({*counts, *pairs}, reverse=True) if n >= FEWEST_SEEDS and median_confidence(n) < LEVEL]
    if weak:
        words += "; of few seeds their range, with less: " + listed(
            f"{shown(Percent(median_confidence(n)))} for {n} seeds" for n in weak
        )
    few = " A single value has neither interval nor test, and where none is known the cell is empty."
    return f"{words}.{few if min(counts) < FEWEST_SEEDS else ''}"


def _test_notes(ablation: Ablation, metric: Metric) -> list[str]:
    """Explain the columns beside the median; nothing without a reference."""
    frame = ablation.arms[metric]
    kinds = frame.comparability.dropna()
    if kinds.empty:
        return []
    outside = {Comparability.too_few_seeds, Comparability.by_construction, Comparability.not_tested}
    reference, family = ablation.requested_reference, int((~kinds.isin(outside)).sum())
    same, level, few = (
        kinds.index[kinds == kind].tolist()
        for kind in (Comparability.identical, Comparability.equal_values, Comparability.too_few_differ)
    )
    notes = [
        f"Runs that differ: those that are not the run of {reference} of the same seed, candidate by candidate. All "
        "further columns are of these runs, as far as their values are known: what is one and the same run in both "
        "arms shows nothing of the arm."
    ]
    if family:
        notes.append(
            f"p: two-sided Mann-Whitney U of an arm's runs against those of {reference}; corrected over "
            f"{counted(family, 'arm')} after Holm, at alpha {ALPHA:g}."
        )
    notes += [
        f"In brackets: {100 * LEVEL:g} % intervals, by Newcombe's method 5 (2006) of A12 and Cliff's delta, by the "
        f"percentiles of {RESAMPLES:,} bootstrap resamples of the difference of medians.",
        f"A12: the chance that a run of the arm has more than one of {reference}. Differences are arm less "
        f"{reference}; by seed: of the runs that share a seed, and so their streams.",
    ]
    notes += _twin_notes(ablation)
    if same:
        notes.append(
            f"Identical: {listed(same)}. No run of such an arm differs from that of {reference} of the same seed: "
            "there is nothing to test. In Holm's correction it counts as p = 1."
        )
    if level:
        notes.append(
            f"Equal values: {listed(level)}. Runs of such an arm differ from those of {reference}, and have the same "
            "values: there is nothing to test. In Holm's correction it counts as p = 1."
        )
    if few:
        notes.append(
            f"Too few runs differ: {listed(few)}. A test needs two in either arm. In Holm's correction such an arm "
            "counts as p = 1."
        )
    tested = frame[frame.u.notna()]
    notes += [
        power_note(
            f"{counted(ours, 'run')} of an arm and {theirs} of {reference}", ours, theirs, alpha=ALPHA, family=family
        )
        for ours, theirs in dict.fromkeys(zip(tested.n_arm.tolist(), tested.n_reference.tolist(), strict=True))
    ]
    return [*notes, *caution_notes(tested.cautions.items())]


def _twin_notes(ablation: Ablation) -> list[str]:
    """Name the arms that are one search by construction, with the reason, and whether their runs are equal."""
    notes = []
    if same := twins_of(ablation.requested_reference, ablation.twins):
        notes.append(
            f"Identical by construction: {listed(same)}. With prompts=uniform nothing is drawn by the "
            f"record of prompts, which is all that differs from {ablation.requested_reference}, so these are the same "
            "searches under another name: known before they ran, not tested, and not counted in Holm's correction."
        )
    notes += [
        f"Identical by construction: {one} and {other}, which are tested as two arms."
        for one, other in ablation.twins
        if not {one, other} <= {ablation.requested_reference, *same}
    ]
    if unequal := ablation.unequal_twins:
        notes.insert(0, divergence(unequal))
    elif notes:
        notes.append("Runs of such arms and one seed were compared: they are equal, candidate by candidate.")
    return notes


def divergence(unequal: Sequence[tuple[str, str]]) -> str:
    """Say loudly that runs differ which must not."""
    pairs = listed(f"{one} and {other}" for one, other in unequal)
    return (
        f"ERROR: {pairs} are one search by construction, and differ. Believe neither before `tacevo replay` of both: "
        "they were made by other code, on machines that compute otherwise, or with stores of their own, for which a "
        "model was asked twice."
    )


def temperature_notes(sweep: RecordedSweep) -> tuple[str, ...]:
    """Say what carries temperatures, and what one of the grammar is, where arms differ in them."""
    runs = [one.run for one in sweep.finished]
    differ = len({run.config.temperature for run in runs}) > 1
    return (*carrier_notes(runs), *grammar_note(runs)) if differ else ()


def _rank_note(sweep: RecordedSweep, ablation: Ablation, metric: Metric) -> list[str]:
    """Say whether a metric is the primary one; nothing where the sweep states none."""
    if ablation.primary is None or metric is ablation.primary:
        return _primary_note(sweep, ablation)
    words = f"Secondary metric; the primary one is {ablation.primary.value}."
    if metric is Metric.best_fitness:
        words += (
            " The lowest of many fitnesses is a noisy minimum: each is one draw, so an arm that draws "
            "more often may have a lower one for that reason alone."
        )
    return [words]


def _primary_note(sweep: RecordedSweep, ablation: Ablation) -> list[str]:
    """Name the primary metric, and say when it was stated and what is missing of it."""
    if ablation.primary is None:
        return []
    when = (
        "before its jobs were tested, after their searches"
        if sweep.terms.primary is None
        else "when it began, before anything was trained"
    )
    notes = [f"Primary metric: {ablation.primary.value}, as the sweep stated {when}; all others are secondary."]
    if ablation.primary in TESTED and sweep.terms.retraining is None:
        words = "tacevo study sweep=DIR, with the directory of the sweep, trains and tests what they found."
        notes.append(f"No job has a {ablation.primary.value} yet: {words}")
    return notes


def _tested_notes(sweep: RecordedSweep) -> list[str]:
    """Say which networks were tested, and how; nothing where none was to be."""
    stated = sweep.terms.retraining
    if stated is None:
        return []
    which = "network" if stated.tested == 1 else f"{stated.tested} networks"
    among = f", of the baseline and the {stated.elites} fittest elites" if stated.elites > stated.tested else ""
    notes = [
        f"Tested: the {which} with {_CHOSEN[stated.choose]}{among}, trained for "
        f"{counted(stated.epochs, 'epoch')} with {counted(stated.seeds, 'fresh seed')}."
    ]
    if stated.other_device:
        settings = assignments(stated.other_device)
        notes.append(f"Trained with other settings than the searches: {', '.join(settings)}.")
    if sweep.not_tested:
        notes.append(f"Not tested, as the sweep states: {listed(sweep.not_tested)}. No family counts such an arm.")
    tests = [(one.job.name, one.tested) for one in sweep.finished if one.tested is not None]
    if lacking := [f"{name} ({test.lacking})" for name, test in tests if test.lacking]:
        notes.append(
            "The archive had no other network for so many places of these jobs, and the baseline counts in the places "
            f"that are left, so that every value is of as many: {listed(lacking)}."
        )
    if late := sum(test.late for _, test in tests):
        trainings = sum(len(set(test.networks)) for _, test in tests) * stated.seeds
        notes.append(
            f"{late} of {counted(trainings, 'training')} had the best epoch in the last tenth, and might end better "
            "with more epochs=."
        )
    return notes


def _reference_note(sweep: RecordedSweep, ablation: Ablation) -> list[str]:
    """Say that the reference was named afterwards, or that there is none."""
    stated = sweep.terms.reference
    if ablation.reference is None:
        return [
            f"There is no test: the sweep has no finished run of the arm {ablation.requested_reference}, which others "
            "are compared with."
        ]
    if ablation.reference != (stated or REFERENCE):
        other = f"the arm {stated}" if stated else "no other than an arm called none"
        return [f"The reference {ablation.reference} was named for this comparison; the sweep itself states {other}."]
    return []


def _missing_note(sweep: RecordedSweep) -> list[str]:
    missing, untested = (listed(one.job.name for one in ones) for ones in (sweep.missing, sweep.untested))
    notes = []
    if sweep.missing:
        notes.append(
            f"Missing, {counted(len(sweep.missing), 'job')}: {missing}. Once they are finished, the family of Holm's "
            "correction may be larger, and every value of the common archive may change."
        )
    if sweep.untested:
        notes.append(f"Without a test score, {counted(len(sweep.untested), 'job')}: {untested}.")
    return notes


def _failed_note(sweep: RecordedSweep, metric: Metric) -> list[str]:
    """Name the jobs that failed at what a metric measures, each with what failed."""
    tests = sweep.untested if metric in TESTED else ()
    failed = [(one, "its test") for one in tests if one.has_failed]
    failed += [(one, "its search") for one in sweep.missing if one.has_failed]
    if metric in SPENT or not failed:
        return []
    names = listed(f"{one.job.name} (arm {one.job.arm}, {what})" for one, what in failed)
    return [
        f"Failed, {counted(len(failed), 'job')}: {names}. In tests, effect sizes and differences each counts as worse "
        "than any other job, with the worst value that is known; medians leave it out."
    ]


def common_note(niches_of: str) -> str:
    """Name the archive that coverage and QD-score were counted in."""
    return (
        "QD-score and coverage are those of one common archive: every trained candidate of a run, in order, in the "
        f"niches of {niches_of} under bounds common to all runs. They are not those of a run's own ledger."
    )


def extents_note(extents: pd.DataFrame) -> str:
    """Name the candidates that decide the bounds of the common archive, and how close these leave all others."""
    axes = (
        f"{one.axis} from {_end(one.low, one.lowest)} to {_end(one.high, one.highest)}, with "
        f"{shown(Percent(one.fullest))} of all candidates in the fullest tenth"
        for one in extents.itertuples()
    )
    return (
        f"Its bounds: {'; '.join(axes)}. A single candidate may decide a bound, and with it how many niches all fill."
    )


def _end(value: float, candidates: Sequence[str]) -> str:
    """Write a bound with the candidates that it is due to, or that it was fixed."""
    if not candidates:
        return f"{shown(value)} (fixed)"
    more = f" and {len(candidates) - 1} more" if len(candidates) > 1 else ""
    return f"{shown(value)} ({candidates[0]}{more})"
