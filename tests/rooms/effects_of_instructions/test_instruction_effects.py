"""Promise: what an instruction does is told apart from its parent, its generation and its temperature."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import statsmodels.api
from hand_runs import altered, closed, rejected, run, trained

from analysis.runs.instruction_effects import INSTRUCTIONS, instruction_effects
from analysis.tables.instruction_tables import instructions_table, mix_table
from tacevo.evolution.lines import CandidateLine
from tacevo.results.run import RecordedRun

NAMES = ("worse", "even", "better")
#: By what each moves the logarithm of the loss.
MOVES = (0.3, 0.0, -0.3)


def searched(seed: int, *, generations: int = 8, warmth: float = 0.0, noise: float = 0.05) -> RecordedRun:
    """Make a search whose late children are better, and whose bad parents have bad children."""
    rng = np.random.default_rng(seed)
    lines: list[CandidateLine] = [trained(0, 0, 1.0)]
    for generation in range(1, generations + 1):
        for slot in range(12):
            parent = lines[int(rng.integers(len(lines)))]
            prompt, temperature = int(rng.integers(3)), float(rng.uniform(0.4, 0.6))
            level = -0.1 * generation + 0.5 * math.log(parent.fitness or 1.0)
            loss = math.exp(level + MOVES[prompt] + warmth * temperature + noise * rng.normal())
            lines.append(trained(generation, slot, loss, parents=(parent.id,), prompt=prompt, temperature=temperature))
    return run(lines, [closed(number) for number in range(generations + 1)], instructions=NAMES)


def test_effects_are_those_that_were_put_in() -> None:
    """Within their intervals, which are narrow; p after Holm says which are none."""
    effects = instruction_effects([searched(seed, warmth=0.4) for seed in range(6)]).set_index("name")
    for name, move in zip((*NAMES, "temperature + 1"), (*MOVES, 0.4), strict=True):
        row = effects.loc[name]
        assert row.effect_low < math.exp(move) < row.effect_high
        assert row.effect_high / row.effect_low < (1.6 if name.startswith("temp") else 1.05)
    assert effects.p_holm["worse"] < 1e-6 > effects.p_holm["better"]
    assert effects.p_holm["even"] > 0.05
    assert pd.isna(effects.p_holm["temperature + 1"])


def test_fit_is_that_of_statsmodels() -> None:
    """Of two searches, with a constant for each generation of each, and contrasts with the mean instruction."""
    runs = [searched(0), searched(1)]
    rows, losses = [], []
    for place, one in enumerate(runs):
        fitness = {line.id: math.log(line.fitness or 1.0) for line in one.candidates}
        for line in one.candidates[1:]:
            groups = [float((place, line.generation) == (at, number)) for at in range(2) for number in range(1, 9)]
            picked = [float(line.prompt == index) for index in range(2)]  # the third is the reference
            rows.append([*picked, fitness[line.parents[0]], line.temperature, *groups])
            losses.append(fitness[line.id])
    fit = statsmodels.api.OLS(losses, np.array(rows)).fit()
    effects = instruction_effects(runs)
    width = len(rows[0])
    for at, (first, second) in enumerate(((2 / 3, -1 / 3), (-1 / 3, 2 / 3), (-1 / 3, -1 / 3))):
        contrast = np.zeros((1, width))
        contrast[0, :2] = first, second
        test = fit.t_test(contrast)
        expected = [float(np.exp(test.effect[0])), *np.exp(test.conf_int()[0]), float(test.pvalue)]
        assert effects.loc[at, ["effect", "effect_low", "effect_high", "p"]].tolist() == pytest.approx(
            expected, rel=1e-6
        )
    assert effects.p.iloc[3] == pytest.approx(fit.pvalues[3], rel=1e-6)


def test_requests_are_counted_with_those_that_gave_nothing() -> None:
    """Shares are of the requests of each half; generation 0 and crossovers are no requests for an instruction."""
    lines = [
        trained(0, 0),
        trained(0, 1, prompt=1),
        trained(1, 0, prompt=0),
        trained(1, 1, prompt=1),
        trained(1, 2, prompt=None, parents=("g00s00", "g00s01")),
        rejected(2, 0, prompt=1),
        trained(2, 1, prompt=1),
    ]
    effects = instruction_effects([run(lines, [closed(number) for number in range(3)], instructions=NAMES)])
    assert effects.dtypes.astype(str).to_dict() == INSTRUCTIONS
    assert effects.requests.tolist() == [1, 3, 0, 4]
    assert effects.children.tolist() == [1, 2, 0, 3]
    assert effects.early.tolist()[:3] == [0.5, 0.5, 0]
    assert effects.late.tolist()[:3] == [0, 1, 0]
    assert effects[["effect", "p", "p_holm"]].isna().all(axis=None)


@pytest.mark.parametrize("kind", ["nothing asked", "one instruction", "no temperature"])
def test_little_gives_an_empty_cell_and_no_error(kind: str) -> None:
    """A search of generation 0, one of a single instruction, and a model that took no temperature."""
    full = searched(0)
    if kind == "nothing asked":
        effects = instruction_effects([run([trained(0, 0)], [closed(0)], instructions=NAMES)])
        assert effects.requests.tolist() == [0, 0, 0, 0]
        assert effects.late.isna().all()
    elif kind == "one instruction":
        alone = [line if line.prompt is None else replace(line, prompt=1) for line in full.candidates]
        effects = instruction_effects([altered(full, candidates=tuple(alone))])
        assert effects.effect.isna().all()
    else:
        dropped = [replace(line, dropped=("temperature",)) for line in full.candidates]
        effects = instruction_effects([altered(full, candidates=tuple(dropped))])
        assert effects.effect.notna().tolist() == [True, True, True, False]


def test_instructions_that_are_not_told_apart_have_no_effect() -> None:
    """One was asked for in the first generations only, so it and these are one; losses may all be equal, too."""
    full = searched(0)
    early = [
        line if line.prompt is None else replace(line, prompt=2 * (line.generation > 4)) for line in full.candidates
    ]
    apart = instruction_effects([altered(full, candidates=tuple(early))])
    assert apart.requests.tolist()[:3] == [48, 0, 48]
    assert apart.effect.notna().tolist() == [False, False, False, True]
    equal = [replace(line, fitness=0.5) for line in full.candidates]
    effects = instruction_effects([altered(full, candidates=tuple(equal))])
    assert effects.effect.dropna().tolist() == pytest.approx([1.0] * 4)


def test_tables_show_them_and_say_what_a_grammars_temperature_is() -> None:
    """One row an instruction; an arm has the shares of its later half."""
    runs = [searched(0), searched(1)]
    table = instructions_table(runs, "all arms")
    assert [row[0] for row in table.rows] == [*NAMES, "temperature + 1"]
    assert any("mutation strength" in note for note in table.notes)
    mix = mix_table({"none": runs[:1], "drift": runs[1:]}, "force")
    assert mix.columns == ("instruction", "none", "drift")
    assert sum(row[1].value for row in mix.rows) == pytest.approx(1)  # type: ignore[misc, union-attr]
