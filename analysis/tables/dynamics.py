"""Tables of how a search went: generations, gate, prompts, improvement, and where a network comes from."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.runs.archive_history import archive_medians
from analysis.runs.dynamics import (
    MOST,
    PUBLISHED_GENERATIONS,
    by_model,
    by_prompt,
    by_temperature,
    improvement,
    progress,
    temperature_follows_age,
)
from analysis.runs.lineage import lineage
from analysis.statistics.effects import LEVEL
from analysis.studies.reestimates import Reestimates, by_seeds
from analysis.table import Cell, Interval, Layout, Percent, Table, percent
from analysis.tables.grammar_note import carrier_notes, grammar_note
from tacevo.evolution.lines import TEMPERATURE, gate_stages, misreported, skipped_note
from tacevo.records import Stage
from tacevo.results.run import RecordedRun
from tacevo.results.summary import TRIVIAL, worth
from tacevo.text import counted

#: Below every improvement, after what a fitness is.
OTHER_SEEDS = "What other seeds give stands in the tables of noise, once tacevo noise or tacevo study has trained them."

#: The figures of an improvement by name: their words, and whether they are parts.
_FIGURES = {
    "baseline": ("fitness of the baseline", False),
    "first": ("best fitness of generation 0", False),
    "last": ("best fitness at the end", False),
    "over_first": ("improvement over the best of generation 0", True),
    "over_baseline": ("improvement over the baseline", True),
    "settled": (f"generation by which {100 * MOST:g} % of the improvement over generation 0 was reached", False),
    **{f"by_{at}": (f"part of it that was reached by generation {at}", True) for at in PUBLISHED_GENERATIONS},
    "trainable": ("trainable candidates, mean over generations", True),
    "coverage": ("coverage at the end", True),
    "new_quartile": ("fitness that a quarter of the new candidates of the later generations reach", False),
    "new_median": ("fitness that half of them reach", False),
}

#: Of a trivial loss.
TRIVIAL_LOSS = f"Trivial loss: {TRIVIAL}."


def generations_table(run: RecordedRun, centroids: NDArray[np.float64]) -> Table:
    """Show every generation of a run."""
    unsent = [f"T is what was planned; {run.not_sent[TEMPERATURE]}."] if TEMPERATURE in run.not_sent else []
    medians = pd.Series(archive_medians(run, centroids), [line.generation for line in run.generations], dtype="float64")
    generations = progress(run).assign(median=medians).reset_index()
    return Table.of(
        generations,
        {"generation": "generation", f"T{run.carried}": "temperature", "candidates": "candidates", "trained": "trained"}
        | ({"skipped": "skipped"} if generations.skipped.any() else {})
        | {f"rejected: {stage}": f"rejected_{stage}" for stage in Stage}
        | {"best": "best", "archive median": "median", "median of new": "generation_median", "QD-score": "qd_score"}
        | {"coverage": (Percent, "coverage")}
        | {name: name for name in ("elites", "growth", "lost", "new", "improved", "repeated", "unchanged")},
        name="generations",
        caption=f"The generations of {run.name}.",
        notes=(
            f"Trained and rejected count first answers. {_statuses(run)}",
            "Archive median: of the elites after the generation; median of new: of its own trained candidates. "
            "Lost: niches that emptied as bounds moved, less those that filled so.",
            "In generation 0 the baseline has one of the slots, and counts as a candidate here.",
            "Repeated: the same source was evaluated before; unchanged: the answer is a parent, words aside.",
            *unsent,
            *carrier_notes([run]),
        ),
    )


def _statuses(run: RecordedRun) -> str:
    if run.has_niches:
        return "New: found their niche empty; improved: beat its elite."
    return f"New: found a place empty among the best {run.places}; improved: took the place of the worst of them."


def costs_table(run: RecordedRun) -> Table:
    """Show what the answers of every generation cost when they were recorded."""
    return Table.of(
        progress(run).reset_index(),
        {"generation": "generation", "answers": "answers", "input tokens": "input_tokens"}
        | {"output tokens": "output_tokens", "USD": "usd"},
        name="costs",
        caption=f"What the answers of {run.name} cost when they were recorded.",
        notes=("A cell is empty where the run's timings lack the cost of an answer.",),
    )


def gate_table(run: RecordedRun) -> Table:
    """Show where first answers were rejected, and how many for misreporting themselves."""
    stages = gate_stages(run.candidates)
    rows = tuple(
        (
            stage.stage.value,
            stage.rejected,
            stage.left,
            percent(stage.left_share),
            ", ".join(f"{reason} {count}" for reason, count in stage.reasons) or None,
        )
        for stage in stages
    )
    return Table(
        name="gate",
        caption=f"Where the gate rejected first answers of {run.name}; the baseline is not an answer.",
        columns=("stage", "rejected", "left", "share left", "reasons"),
        rows=rows,
        notes=(*misreported(stages), *skipped_note(run.candidates)),
    )


def prompts_table(run: RecordedRun) -> Table:
    """Show what every instruction brought, with its index in the library."""
    return _productivity_table(run, "prompts", by_prompt(run), {"index": "index", "instruction": "name"})


def temperatures_table(run: RecordedRun) -> Table:
    """Show what every band of the temperatures that were sent brought."""
    table = _productivity_table(run, "temperatures", by_temperature(run), {f"temperature{run.carried}": "name"})
    notes = [f"{run.not_sent[TEMPERATURE]}."] if TEMPERATURE in run.not_sent else []
    if temperature_follows_age(run):
        notes.append(
            "T moved one way with the generations, so temperature and generation are one here: a difference between "
            "bands may be one between early and late generations, whose archives are filled differently."
        )
    return replace(table, notes=(*table.notes, *notes, *carrier_notes([run]), *grammar_note([run])))


def models_table(run: RecordedRun) -> Table:
    """Show what came of the answers of each model, in a search with several."""
    return Table.of(
        by_model(run),
        {"model": "name", "asked": "tried", "trained": "trained", "inserted": "inserted"}
        | {"inserted / asked": (Interval, "rate", "rate_low", "rate_high")}
        | {"mean gain": "gain", "input tokens": "input_tokens", "output tokens": "output_tokens", "USD": "usd"},
        name="models",
        caption=f"What came of the answers of each model of {run.name}.",
        notes=(
            f"Of all generations. Chosen by llm.choice={run.config.llm.choice}. Inserted: the archive took the child; "
            f"Wilson intervals at {100 * LEVEL:g} %.",
            "Gain: the logarithm by which a child's loss is below that of its better parent, at most 1; 0 where it is "
            "not below, or where the child did not train.",
            "Tokens and dollars are those of when the answers were recorded; a cell is empty where one is not known.",
        ),
    )


def improvement_table(run: RecordedRun, reestimates: Sequence[Reestimates] = ()) -> Table:
    """Show how far a run came, one figure a row; empty without a training.

    Of re-estimates of its fitnesses, those of the most seeds that have its best network stand beside.
    """
    gains = improvement(run)
    rows: list[tuple[str, Cell]] = [
        (words, percent(gains[name]) if is_part else gains[name])
        for name, (words, is_part) in _FIGURES.items()
        if name in gains
    ]
    if rows:
        trivial = [] if run.record.trivial is None else [("trivial loss", run.record.trivial)]
        rows = [*trivial, *rows, *_reestimated_rows(run, reestimates)]
    return Table(
        name="improvement",
        caption=f"How far {run.name} came.",
        columns=("figure", "value"),
        rows=tuple(rows),
        notes=(
            *([run.shortfall] if run.shortfall else []),
            f"Every fitness, a validation loss, is {worth(run.config)} {OTHER_SEEDS}",
            *([] if run.record.trivial is None else [TRIVIAL_LOSS]),
        ),
    )


def reestimated(run: RecordedRun, reestimates: Sequence[Reestimates]) -> tuple[str, float, float] | None:
    """Return what other seeds give for the baseline and for the best candidate, by the re-estimates of the most seeds.

    Returns:
        How it was estimated, in words, the median fitness of the baseline and that of the best candidate; None where
        the best candidate was not trained again.
    """
    for one in by_seeds(reestimates):
        reference, estimate = one.medians[0], one.median_of(run.ranked()[0].id)
        if estimate is not None and reference:
            words = f"re-estimated by a {one.kind}, median of {counted(one.seeds, 'other seed')}"
            return words, reference, estimate
    return None


def _reestimated_rows(run: RecordedRun, reestimates: Sequence[Reestimates]) -> list[tuple[str, float | Percent]]:
    retrained = reestimated(run, reestimates)
    if retrained is None:
        return []
    words, reference, best = retrained
    return [
        (f"fitness of the baseline, {words}", reference),
        (f"best fitness, {run.ranked()[0].id}, {words}", best),
        (f"improvement over the baseline, {words}", Percent((reference - best) / reference)),
    ]


def lineage_table(run: RecordedRun, name: str) -> Table:
    """Show where a candidate comes from; raises as `analysis.runs.lineage.ancestors` does."""
    frame = lineage(run, name)
    return Table.of(
        frame.assign(parents=[", ".join(parents) or None for parents in frame.parents]).reset_index(),
        {"network": "id", **{column: column for column in ("operator", "instruction", "parents", "fitness", "gain")}},
        name="lineage",
        caption=f"The ancestors of {name} in {run.name}.",
        notes=("Gain: how much less loss than the better parent.",),
    )


def _productivity_table(run: RecordedRun, name: str, frame: pd.DataFrame, first: Layout) -> Table:
    rate, (*_, of) = (Interval, "rate", "rate_low", "rate_high"), first
    return Table.of(
        frame.reset_index(),
        {**first, "tried": "tried", "trained": "trained", "inserted": "inserted", "inserted / tried": rate},
        name=name,
        caption=f"Children of {run.name} that entered the archive, by {of}.",
        notes=(f"Mutations from generation 1 on; Wilson intervals at {100 * LEVEL:g} %.",),
    )
