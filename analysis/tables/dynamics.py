"""Tables of how a search went: generations, gate, prompts, improvement, and where a network comes from."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from analysis.runs.archive_history import archive_medians
from analysis.runs.dynamics import (
    LEVEL,
    MOST,
    Productivity,
    by_prompt,
    by_temperature,
    improvement,
    progress,
    temperature_follows_age,
)
from analysis.runs.lineage import lineage
from analysis.runs.run import Run
from analysis.studies.noise import Reestimates
from analysis.table import Between, Percent, Table, percent
from tacevo.costs import Spending
from tacevo.evolution.lines import TEMPERATURE, gate_stages, misreported
from tacevo.records import Stage
from tacevo.text import counted, drawn

#: Below every improvement.
ONE_DRAW = (
    "Every fitness is one draw: the loss of one training seed, and the best is the lowest of many draws. What other "
    "seeds give stands in the tables of noise, once tacevo noise or tacevo study has trained them."
)

#: Of a trivial loss.
TRIVIAL_LOSS = "Trivial loss: the least that the same answer to every validation image can have."

#: The same where a fitness is a median.
MEDIAN = ONE_DRAW.replace("one draw: the loss of one training seed", "{record}").replace("many draws", "many medians")


def generations_table(run: Run, centroids: NDArray[np.float64]) -> Table:
    """Show every generation of a run."""
    rows = tuple(
        (
            entry.line.generation,
            entry.line.temperature,
            entry.line.candidates,
            entry.line.trained,
            *(entry.rejected[stage] for stage in Stage),
            entry.line.best,
            median,
            entry.line.generation_median,
            entry.line.qd_score,
            Percent(entry.line.coverage),
            entry.elites,
            entry.growth,
            entry.lost,
            entry.new,
            entry.improved,
            entry.repeated,
            entry.unchanged,
        )
        for entry, median in zip(progress(run), archive_medians(run, centroids), strict=True)
    )
    stages = tuple(f"rejected: {stage}" for stage in Stage)
    fitness = ("best", "archive median", "median of new")
    archive = ("QD-score", "coverage", "elites", "growth", "lost", "new", "improved")
    unsent = [f"T is what was planned; {run.not_sent[TEMPERATURE]}."] if TEMPERATURE in run.not_sent else []
    return Table(
        name=f"generations_{run.task}",
        caption=f"The generations of {run.name}.",
        columns=("generation", "T", "candidates", "trained", *stages, *fitness, *archive, "repeated", "unchanged"),
        rows=rows,
        notes=(
            f"Trained and rejected count first answers. {_statuses(run)}",
            "Archive median: of the elites after the generation; median of new: of its own trained candidates. "
            "Lost: niches that emptied as bounds moved, less those that filled so.",
            "In generation 0 the baseline has one of the slots, and counts as a candidate here.",
            "Repeated: the same source was evaluated before; unchanged: the answer is its parent.",
            *unsent,
        ),
    )


def _statuses(run: Run) -> str:
    """Explain `new` and `improved`."""
    if run.has_niches:
        return "New: found their niche empty; improved: beat its elite."
    return f"New: found a place empty among the best {run.places}; improved: took the place of the worst of them."


def costs_table(run: Run) -> Table:
    """Show what the answers of every generation cost when they were recorded."""
    rows = tuple((entry.line.generation, *_cost_cells(entry.spent)) for entry in progress(run))
    return Table(
        name=f"costs_{run.task}",
        caption=f"What the answers of {run.name} cost when they were recorded.",
        columns=("generation", "answers", "input tokens", "output tokens", "USD"),
        rows=rows,
        notes=("A cell is empty where the run's timings lack the cost of an answer.",),
    )


def gate_table(run: Run) -> Table:
    """Show where first answers were rejected, and how many for misreporting themselves."""
    stages = gate_stages(run.candidates)
    rows = tuple(
        (
            found.stage.value,
            found.rejected,
            found.left,
            percent(found.left_share),
            ", ".join(f"{reason} {count}" for reason, count in found.reasons) or None,
        )
        for found in stages
    )
    return Table(
        name=f"gate_{run.task}",
        caption=f"Where the gate rejected first answers of {run.name}; the baseline is not an answer.",
        columns=("stage", "rejected", "left", "share left", "reasons"),
        rows=rows,
        notes=tuple(misreported(stages)),
    )


def prompts_table(run: Run) -> Table:
    """Show what every instruction brought, with its index in the library."""
    table = _productivity_table(run, f"prompts_{run.task}", "instruction", by_prompt(run))
    rows = tuple((index, *row) for index, row in enumerate(table.rows))
    return replace(table, columns=("index", *table.columns), rows=rows)


def temperatures_table(run: Run) -> Table:
    """Show what every band of the temperatures that were sent brought."""
    table = _productivity_table(run, f"temperatures_{run.task}", "temperature", by_temperature(run))
    notes = [f"{run.not_sent[TEMPERATURE]}."] if TEMPERATURE in run.not_sent else []
    if temperature_follows_age(run):
        notes.append(
            "T moved one way with the generations, so temperature and generation are one here: a difference between "
            "bands may be one between early and late generations, whose archives are filled differently."
        )
    return replace(table, notes=(*table.notes, *notes))


def improvement_table(run: Run, reestimates: Sequence[Reestimates] = ()) -> Table:
    """Show how far a run came, one figure a row, beside re-estimates where there are some; empty without a training.

    Args:
        run: the run.
        reestimates: of its fitnesses; those of the most seeds that have its best network are shown.
    """
    found = improvement(run)
    rows: list[tuple[str, float | int | Percent | None]] = []
    if found is not None:
        rows = [
            *([] if run.trivial is None else [("trivial loss", run.trivial)]),
            ("fitness of the baseline", found.baseline),
            ("best fitness of generation 0", found.first),
            ("best fitness at the end", found.last),
            ("improvement over the best of generation 0", Percent(found.over_first)),
            ("improvement over the baseline", Percent(found.over_baseline)),
            (f"generation by which {100 * MOST:g} % of the improvement over generation 0 was reached", found.settled),
            *((f"part of it that was reached by generation {at}", Percent(share)) for at, share in found.by_generation),
            ("trainable candidates, mean over generations", percent(found.trainable)),
            ("coverage at the end", Percent(found.coverage)),
            *_reestimated_rows(run, reestimates),
        ]
    return Table(
        name=f"improvement_{run.task}",
        caption=f"How far {run.name} came. Fitness is a validation loss.",
        columns=("figure", "value"),
        rows=tuple(rows),
        notes=(
            *([run.shortfall] if run.shortfall else []),
            ONE_DRAW if run.record == drawn(1) else MEDIAN.format(record=run.record),
            *([] if run.trivial is None else [TRIVIAL_LOSS]),
        ),
    )


def by_seeds(reestimates: Sequence[Reestimates]) -> list[Reestimates]:
    """Return re-estimates with those of the most seeds first; where several know a network, the first one counts."""
    return sorted(reestimates, key=lambda one: (-one.noise.seeds, one.name))


def reestimated(run: Run, reestimates: Sequence[Reestimates]) -> tuple[str, float, float] | None:
    """Return what other seeds give for the baseline and for the best candidate, by the re-estimates of the most seeds.

    Returns:
        How it was estimated, in words, the median fitness of the baseline and that of the best candidate; None where
        the best candidate was not trained again.
    """
    for one in by_seeds(reestimates):
        reference, found = one.noise.networks[0].median, one.of(run.ranked()[0].id)
        if found is not None and reference:
            words = f"re-estimated by a {one.kind}, median of {counted(one.noise.seeds, 'other seed')}"
            return words, reference, found.median
    return None


def _reestimated_rows(run: Run, reestimates: Sequence[Reestimates]) -> list[tuple[str, float | Percent]]:
    found = reestimated(run, reestimates)
    if found is None:
        return []
    words, reference, best = found
    return [
        (f"fitness of the baseline, {words}", reference),
        (f"best fitness, {run.ranked()[0].id}, {words}", best),
        (f"improvement over the baseline, {words}", Percent((reference - best) / reference)),
    ]


def lineage_table(run: Run, name: str) -> Table:
    """Show where a candidate comes from; raises as `analysis.runs.lineage.ancestors` does."""
    rows = tuple(
        (
            entry.candidate.id,
            entry.candidate.operator.value,
            entry.instruction,
            ", ".join(entry.candidate.parents) or None,
            entry.fitness,
            entry.gain,
        )
        for entry in lineage(run, name)
    )
    return Table(
        name=f"lineage_{run.task}",
        caption=f"The ancestors of {name} in {run.name}.",
        columns=("network", "operator", "instruction", "parents", "fitness", "gain"),
        rows=rows,
        notes=("Gain: how much less loss than the better parent.",),
    )


def _productivity_table(run: Run, name: str, of: str, found: tuple[Productivity, ...]) -> Table:
    rows = tuple((entry.name, entry.tried, entry.trained, entry.inserted, _between(entry)) for entry in found)
    return Table(
        name=name,
        caption=f"Children of {run.name} that entered the archive, by {of}.",
        columns=(of, "tried", "trained", "inserted", "inserted / tried"),
        rows=rows,
        notes=(f"Mutations from generation 1 on; Wilson intervals at {100 * LEVEL:g} %.",),
    )


def _between(entry: Productivity) -> Between | None:
    if entry.rate is None or entry.interval is None:
        return None
    return Between(entry.rate, *entry.interval)


def _cost_cells(spent: Spending | None) -> tuple[int | float | None, ...]:
    """Return the cells of a spending; tokens and dollars only where those of every answer are known."""
    if spent is None:
        return (None,) * 4
    dollars = None if spent.unpriced else spent.usd
    tokens = (None, None) if spent.uncounted else (spent.input_tokens, spent.output_tokens)
    return spent.answers, *tokens, dollars
