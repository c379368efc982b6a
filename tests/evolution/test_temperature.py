"""Promise: the three temperature rules move as the paper and docs/paper.md say, and never leave [0, 1]."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacevo.choices import TemperatureRule
from tacevo.evolution.proposals import next_temperature

LOSSES = st.floats(0, 1e6)


@pytest.mark.parametrize(
    ("rule", "best", "expected"),
    [
        (TemperatureRule.paper, 0.1, 0.65),
        (TemperatureRule.paper, 0.2, 0.65),
        (TemperatureRule.paper, 0.3, 0.55),
        (TemperatureRule.stall, 0.1, 0.55),
        (TemperatureRule.stall, 0.2, 0.65),
        (TemperatureRule.stall, 0.3, 0.65),
        (TemperatureRule.fixed, 0.1, 0.6),
        (TemperatureRule.fixed, 0.2, 0.6),
        (TemperatureRule.fixed, 0.3, 0.6),
    ],
)
def test_each_rule_moves_as_it_is_written(rule: TemperatureRule, best: float, expected: float) -> None:
    """From T = 0.6 and a best of 0.2: a better best, an equal one, a worse one."""
    assert next_temperature(rule, 0.6, best=best, best_before=0.2, step=0.05) == expected


@given(st.sampled_from(TemperatureRule), st.floats(0, 1), LOSSES, LOSSES, st.floats(0, 1))
def test_temperature_stays_in_its_range(
    rule: TemperatureRule, temperature: float, best: float, best_before: float, step: float
) -> None:
    """Whatever happens, the next temperature is in [0, 1]."""
    assert 0 <= next_temperature(rule, temperature, best=best, best_before=best_before, step=step) <= 1


def test_steps_gather_no_dust() -> None:
    """Twenty steps of 0.05 up from 0 make 1, and eight up from 0.6 do as well, with every step a round number."""
    reached = [0.0]
    for _ in range(20):
        reached.append(next_temperature(TemperatureRule.paper, reached[-1], best=0, best_before=0, step=0.05))
    assert reached == [round(0.05 * step, 12) for step in range(21)]
