"""The table of a lineage: where a network comes from."""

from analysis.runs.lineage import lineage
from analysis.runs.run import Run
from analysis.table import Table


def lineage_table(run: Run, name: str) -> Table:
    """Show where a candidate comes from; raises as `analysis.runs.lineage.ancestors` does."""
    rows = tuple(
        (
            entry.candidate.id,
            entry.candidate.operator.value,
            entry.instruction,
            ", ".join(entry.candidate.parents) or None,
            entry.candidate.fitness,
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
