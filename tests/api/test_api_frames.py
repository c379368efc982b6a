"""Promise: the frames of the Python API have the columns and dtypes that docs/python.md lists, whatever a run holds."""

import re

import pytest
from checkout import ROOT

from analysis.runs.dynamics import GENERATIONS
from analysis.sweeps.ablation import ARMS
from analysis.sweeps.rejections import RATES
from tacevo.api import frames
from tacevo.api.frames import Columns, frame

LISTED: dict[str, Columns] = {
    "run.candidates": frames.CANDIDATES,
    "run.generations": {"generation": "int64", **GENERATIONS, "hypervolume": "float64"},
    "run.elites": frames.ELITES,
    "run.prompts": frames.PROMPTS,
    "study.networks": frames.NETWORKS,
    "study.scores": frames.SCORES,
    "study.verdicts": frames.VERDICTS,
    "study.reestimates": frames.REESTIMATES,
    "sweep.jobs": frames.JOBS,
    "sweep.contrasts(METRIC)": {"arm": "str", **ARMS},
    "tacevo.check": frames.CHECKS,
    "table.networks": frames.TABLE_NETWORKS,
    "table.trainings": frames.TABLE_TRAININGS,
    "table.scores": frames.TABLE_SCORES,
    "table.size_and_power(SWEEP, seeds=N)": RATES,
}


@pytest.mark.room("Pareto", "table")
def test_every_column_is_listed() -> None:
    """In order, with its dtype; and nothing else is."""
    from analysis.runs.pareto import PARETO
    from analysis.statistics.spaces import BY_EPOCHS

    expected = {**LISTED, "run.pareto(OBJECTIVES)": {"id": "str", **PARETO}, "table.worth": BY_EPOCHS}
    # An optimiser's problem has no frame.
    _, *parts = re.split(r"^### `([^`]+)`.*$", (ROOT / "docs/python.md").read_text(), flags=re.MULTILINE)
    listed = {
        name: {
            column: dtype
            for columns, dtype in re.findall(r"^\| (`.+?`) \| `(\w+)` \| ", table, flags=re.MULTILINE)
            for column in re.findall(r"`(\w+)`", columns)
        }
        for name, table in zip(parts[::2], parts[1::2], strict=True)
        if not name.startswith("table.as_problem(")
    }
    assert listed == expected
    assert all([*listed[name]] == [*columns] for name, columns in expected.items())


#: Frames that `frame` makes; the others are the analysis's.
OTHERS = {"run.generations", "sweep.contrasts(METRIC)", "table.size_and_power(SWEEP, seeds=N)"}

MADE = {name: columns for name, columns in LISTED.items() if name not in OTHERS}


@pytest.mark.parametrize("columns", MADE.values(), ids=MADE)
def test_frame_has_its_dtypes_with_and_without_rows(columns: Columns) -> None:
    """A value that a row lacks is missing, and never 0 or an empty text."""
    empty: dict[str, object] = {}
    for rows in ([], [empty], [empty, empty]):
        made = frame(rows, columns)
        assert {name: str(dtype) for name, dtype in made.dtypes.items()} == dict(columns)
        assert made.isna().to_numpy().all()
