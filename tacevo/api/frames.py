"""Rows as DataFrames, with the columns and dtypes that docs/python.md lists.

A missing value is missing: NaN in `float64` and `str`, NA in `Int64` and `boolean`, None in `object`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

#: The dtype of each column, in order.
Columns = Mapping[str, str]

CANDIDATES: Columns = {
    "id": "str",
    "generation": "Int64",
    "slot": "Int64",
    "operator": "str",
    "parents": "object",
    "instruction": "str",
    "temperature": "float64",
    "carrier": "str",
    "level": "Int64",
    "effort": "str",
    "model": "str",
    "outcome": "str",
    "stage": "str",
    "reason": "str",
    "repairs": "Int64",
    "fitness": "float64",
    "recorded_fitness": "float64",
    "parameters": "Int64",
    "flops": "Int64",
    "learnt_outside": "Int64",
    "extra_flops": "Int64",
    "entropy": "float64",
    "variation": "float64",
    "density": "float64",
    "arch_div": "float64",
    "eff_ratio": "float64",
    "niche": "Int64",
    "is_elite": "boolean",
    "curiosity": "float64",
    "usd": "float64",
    "cpu_seconds": "float64",
    "source": "str",
}

ELITES: Columns = {
    "niche": "Int64",
    "id": "str",
    "fitness": "float64",
    "parameters": "Int64",
    "flops": "Int64",
    "arch_div": "float64",
    "eff_ratio": "float64",
    "centroid": "object",
}

PROMPTS: Columns = {
    "niche": "Int64",
    "id": "str",
    "instruction": "str",
    "temperature": "float64",
    "inserted": "boolean",
    "curiosity": "float64",
    "centroid": "object",
}

NETWORKS: Columns = {
    "network": "str",
    "id": "str",
    "fitness": "float64",
    "parameters": "Int64",
    "flops": "Int64",
    "source": "str",
}

#: The columns of a study's scores, before a column for each metric.
SCORES: Columns = {
    "network": "str",
    "id": "str",
    "seed": "Int64",
    "epoch": "Int64",
    "validation_loss": "float64",
    "failed": "str",
}

VERDICTS: Columns = {
    "network": "str",
    "id": "str",
    "metric": "str",
    "median": "float64",
    "baseline_median": "float64",
    "u": "float64",
    "p": "float64",
    "p_holm": "float64",
    "a12": "float64",
    "a12_low": "float64",
    "a12_high": "float64",
    "difference": "float64",
    "difference_low": "float64",
    "difference_high": "float64",
    "margin": "float64",
    "p_equivalence": "float64",
    "p_equivalence_holm": "float64",
    "verdict": "str",
    "cautions": "object",
}

REESTIMATES: Columns = {
    "network": "str",
    "id": "str",
    "recorded": "float64",
    "seed": "Int64",
    "fitness": "float64",
}

#: The columns of a sweep's jobs, before a column for each metric.
JOBS: Columns = {
    "job": "str",
    "arm": "str",
    "seed": "Int64",
    "state": "str",
    "reason": "str",
    "digest": "str",
}

#: The columns of the gate's verdicts on answers.
CHECKS: Columns = {
    "file": "str",
    "verdict": "str",
    "stage": "str",
    "reason": "str",
    "detail": "str",
    "parameters": "Int64",
}

#: The columns of the table of a space; the genes are those of `tacevo.space.Space`.
TABLE_NETWORKS: Columns = {
    "network": "Int64",
    "depth": "Int64",
    "width": "Int64",
    "hidden": "Int64",
    "activation": "str",
    "norm": "str",
    "down": "str",
    "pooling": "str",
    "residual": "boolean",
    "dropout": "float64",
    "parameters": "Int64",
    "flops": "Int64",
    "arch_div": "float64",
    "eff_ratio": "float64",
    "refused": "str",
    "source": "str",
}

TABLE_TRAININGS: Columns = {
    "network": "Int64",
    "seed": "Int64",
    "epoch": "Int64",
    "train_loss": "float64",
    "validation_loss": "float64",
}

#: The columns of a table's trainings, before a column for each metric.
TABLE_SCORES: Columns = {
    "network": "Int64",
    "seed": "Int64",
    "epoch": "Int64",
    "validation_loss": "float64",
    "failed": "str",
}


def frame(rows: Iterable[Mapping[str, Any]], columns: Columns, *, index: str | None = None) -> pd.DataFrame:
    """Return a DataFrame of these columns and dtypes, also where there are no rows; a key that a row lacks is missing.

    The index is a column of that name, or else counts the rows.
    """
    import pandas as pd  # takes half a second, which no command that prints no frame pays

    rows = list(rows)
    made = pd.DataFrame(
        {name: pd.Series([row.get(name) for row in rows], dtype=dtype) for name, dtype in columns.items()}
    )
    return made if index is None else made.set_index(index)
