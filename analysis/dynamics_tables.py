"""Tables of how a search went: generations, gate, prompts, improvement."""

from dataclasses import replace

from analysis.dynamics import LEVEL, MOST, Productivity, by_prompt, by_temperature, gate_stages, improvement, progress
from analysis.loading import Run
from analysis.tables import Between, Percent, Table, percent
from tacevo.costs import Spending
from tacevo.records import Stage
from tacevo.unsent import TEMPERATURE


def generations_table(run: Run) -> Table:
    """Show every generation of a run."""
    rows = tuple(
        (
            entry.line.generation,
            entry.line.temperature,
            entry.line.candidates,
            entry.line.trained,
            *(entry.rejected[stage] for stage in Stage),
            entry.line.best,
            entry.line.generation_median,
            entry.line.qd_score,
            Percent(entry.line.coverage),
            entry.elites,
            entry.growth,
            entry.new,
            entry.improved,
            entry.repeated,
            entry.unchanged,
        )
        for entry in progress(run)
    )
    stages = tuple(f"rejected: {stage}" for stage in Stage)
    results = ("best", "median", "QD-score", "coverage", "elites", "growth", "new", "improved", "repeated", "unchanged")
    unsent = [f"T is what was planned; {run.not_sent[TEMPERATURE]}."] if TEMPERATURE in run.not_sent else []
    return Table(
        name=f"generations_{run.task}",
        caption=f"The generations of {run.name}.",
        columns=("generation", "T", "candidates", "trained", *stages, *results),
        rows=rows,
        notes=(
            f"Trained and rejected count first answers. {_statuses(run)}",
            "Repeated: the same source was evaluated before; unchanged: the answer is its parent.",
            *unsent,
        ),
    )


def _statuses(run: Run) -> str:
    """Say what `new` and `improved` count."""
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
        notes=("A place without a value is one that the run's timings do not tell.",),
    )


def gate_table(run: Run) -> Table:
    """Show where first answers were turned away."""
    rows = tuple(
        (
            found.stage.value,
            found.rejected,
            found.left,
            percent(found.left_share),
            ", ".join(f"{reason} {count}" for reason, count in found.reasons) or None,
        )
        for found in gate_stages(run)
    )
    return Table(
        name=f"gate_{run.task}",
        caption=f"Where the gate turned first answers of {run.name} away; the baseline is none.",
        columns=("stage", "rejected", "left", "share left", "reasons"),
        rows=rows,
    )


def prompts_table(run: Run) -> Table:
    """Show what every instruction brought, with its index in the library."""
    table = _productivity_table(run, f"prompts_{run.task}", "instruction", by_prompt(run))
    rows = tuple((index, *row) for index, row in enumerate(table.rows))
    return replace(table, columns=("index", *table.columns), rows=rows)


def temperatures_table(run: Run) -> Table:
    """Show what every band of the temperatures that were sent brought."""
    table = _productivity_table(run, f"temperatures_{run.task}", "temperature", by_temperature(run))
    unsent = [f"{run.not_sent[TEMPERATURE]}."] if TEMPERATURE in run.not_sent else []
    return replace(table, notes=(*table.notes, *unsent))


def improvement_table(run: Run) -> Table:
    """Show how far a run came, one figure a row; empty where nothing was trained."""
    found = improvement(run)
    rows: list[tuple[str, float | int | Percent | None]] = []
    if found is not None:
        rows = [
            ("fitness of the baseline", found.baseline),
            ("best fitness of generation 0", found.first),
            ("best fitness at the end", found.last),
            ("improvement over the best of generation 0", Percent(found.over_first)),
            ("improvement over the baseline", Percent(found.over_baseline)),
            (f"generation by which {100 * MOST:g} % of the improvement over generation 0 was had", found.settled),
            *((f"part of it that was had by generation {at}", Percent(share)) for at, share in found.by_generation),
            ("trainable candidates, mean over generations", percent(found.trainable)),
            ("coverage at the end", Percent(found.coverage)),
        ]
    return Table(
        name=f"improvement_{run.task}",
        caption=f"How far {run.name} came. Fitness is a validation loss.",
        columns=("figure", "value"),
        rows=tuple(rows),
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
    """Give the cells of a spending; dollars only where every answer has a price."""
    if spent is None:
        return (None,) * 4
    dollars = None if spent.unpriced else spent.usd
    return spent.answers, spent.input_tokens, spent.output_tokens, dollars
