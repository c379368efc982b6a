"""The effect of an instruction on a child's fitness. A search draws its instructions at random, so it is an experiment.

The logarithm of a child's fitness is fitted by what its generation and run are, by the logarithm of its parent's
fitness, by its instruction and by the temperature that was sent (ordinary least squares). Temperatures are moved by the
generations and jitter at random within one, which is what is left of them here.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import t as student

from analysis.runs.dynamics import mutations
from analysis.statistics.effects import LEVEL
from analysis.statistics.tests import holm
from tacevo.results.run import RecordedRun
from tacevo.rounding import rounded

#: The columns of the effects, and the type of each, an instruction a row: its requests, and its share of those of the
#: first and of the later half of the generations; the children that trained; by what factor it moves their loss from
#: that of the mean instruction, below 1 lower, with its interval; p of a factor of 1, before and after Holm's
#: correction over the instructions. Missing where no child trained, or too few for the fit. The last row is of a
#: temperature that is higher by 1; it has no shares, and is no part of Holm's family.
INSTRUCTIONS = {
    "name": "str",
    "requests": "int64",
    "early": "float64",
    "late": "float64",
    "children": "int64",
} | dict.fromkeys(("effect", "effect_low", "effect_high", "p", "p_holm"), "float64")

#: The name of the row of the temperature.
TEMPERATURE = "temperature + 1"

#: Degrees of freedom that a fit must leave, so that its intervals say something.
_LEAST = 10

_NUMBERS = ("temperature", "parent", "child")

_Values = NDArray[np.float64]


def instruction_effects(runs: Sequence[RecordedRun]) -> pd.DataFrame:
    """Return what each instruction did (`INSTRUCTIONS`), in the library's order, then the temperature.

    Args:
        runs: one or more of one library, each a search of its own; their mutations from generation 1 on are counted.
    """
    names, asked = runs[0].instructions, _asked_of(runs)
    rows: list[dict[str, Any]] = []
    for index, name in enumerate(names):
        own = asked[asked.prompt == index]
        shares = {part: _share(asked, index, late) for part, late in (("early", False), ("late", True))}
        rows.append({"name": name, "requests": len(own), **shares, "children": int(own.child.count())})
    rows.append({"name": TEMPERATURE, "requests": len(asked), "children": int(asked.child.count())})
    effects = pd.DataFrame(rows, columns=list(INSTRUCTIONS)).astype(INSTRUCTIONS)
    for row, effect in _effects(asked.dropna(subset=["child", "parent"]), len(names)).items():
        effects.loc[row, list(effect)] = list(effect.values())
    tested = effects.index[:-1][effects.p.iloc[:-1].notna()]
    if len(tested):
        effects.loc[tested, "p_holm"] = holm(effects.p[tested].tolist())
    return effects


def late_shares(runs: Sequence[RecordedRun]) -> "pd.Series[float]":
    """Return each instruction's share of the requests of the later half of the generations, by its name."""
    names, asked = runs[0].instructions, _asked_of(runs)
    return pd.Series({name: _share(asked, index, late=True) for index, name in enumerate(names)}, dtype="float64")


def _asked_of(runs: Sequence[RecordedRun]) -> pd.DataFrame:
    """Return the mutations of some runs (`_asked`), with the place of each run."""
    return pd.concat([_asked(run).assign(run=number) for number, run in enumerate(runs)])


def _asked(run: RecordedRun) -> pd.DataFrame:
    """Return the mutations of a run, a request a row; logarithms of fitnesses, missing where there are none."""
    recorded = {line.id: math.log(line.fitness) for line in run.trained if line.fitness}
    last = run.generations[-1].generation
    return pd.DataFrame(
        [
            {
                "generation": line.generation,
                "is_late": 2 * line.generation > last,
                "prompt": line.prompt,
                "temperature": run.acted_temperature(line),
                "parent": recorded.get(line.parents[0]),
                "child": recorded.get(line.id),
            }
            for line in mutations(run)
        ],
        columns=["generation", "is_late", "prompt", *_NUMBERS],
    ).astype(dict.fromkeys(_NUMBERS, "float64"))


def _share(asked: pd.DataFrame, index: int, late: bool) -> float | None:
    half = asked[asked.is_late == late]
    return rounded(int((half.prompt == index).sum()) / len(half)) if len(half) else None


def _effects(children: pd.DataFrame, instructions: int) -> dict[int, dict[str, float]]:
    """Fit the logarithms of the children's losses; return the effects by row, none where too few children trained."""
    tried = sorted(set(children.prompt))
    if len(tried) < 2:
        return {}
    groups = children.groupby(["run", "generation"]).ngroup()
    columns = [*((children.prompt == index).astype("float64") for index in tried), children.parent]
    is_sent = children.temperature.notna().all()
    columns += [children.temperature] if is_sent else []
    # What a group's mean explains is taken out, which fits a constant for each group (Frisch and Waugh 1933).
    within = [(column - column.groupby(groups).transform("mean")).to_numpy() for column in (*columns, children.child)]
    x, y = np.stack(within[:-1], axis=1), within[-1]
    free = len(y) - groups.nunique() - int(np.linalg.matrix_rank(x))
    if free < _LEAST:
        return {}
    inverse = np.linalg.pinv(x)
    fitted = inverse @ y
    variance = float(((y - x @ fitted) ** 2).sum()) / free * (inverse @ inverse.T)
    contrasts = np.zeros((len(tried), len(fitted)))
    contrasts[:, : len(tried)] = np.eye(len(tried)) - 1 / len(tried)
    asked = dict(zip(tried, contrasts, strict=True))
    if is_sent:
        asked[instructions] = np.eye(len(fitted))[-1]
    # What the children do not tell apart, say two instructions that no generation asked for both, is no effect.
    known = {index: row for index, row in asked.items() if np.allclose(row @ inverse @ x, row, atol=1e-9)}
    return {index: _effect(row, fitted, variance, free) for index, row in known.items()}


def _effect(contrast: _Values, fitted: _Values, variance: _Values, free: int) -> dict[str, float]:
    """Return the factor of a contrast of logarithms with its interval, and p of a factor of 1."""
    value, error = float(contrast @ fitted), math.sqrt(max(0.0, float(contrast @ variance @ contrast)))
    reach = float(student.ppf((1 + LEVEL) / 2, free)) * error
    p = 2 * float(student.sf(abs(value) / error, free)) if error else float(value == 0)
    ends = {"effect": value, "effect_low": value - reach, "effect_high": value + reach}
    return {name: rounded(math.exp(end)) for name, end in ends.items()} | {"p": rounded(p)}
