"""Promise: the three temperature rules move as the paper and docs/paper.md say, and never leave [0, 1]."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacevo.evolution.temperatures import Fixed, Paper, Stall
from tacevo.parts import Generation, Temperature

LOSSES = st.floats(0, 1e6)


def ended(temperature: float, best: float, best_before: float) -> Generation:
    """Return a generation that ended."""
    counts = {"candidates": 4, "trained": 4, "inserted": 1}
    return Generation(number=1, temperature=temperature, best=best, best_before=best_before, **counts)


@pytest.mark.parametrize(
    ("rule", "best", "expected"),
    [
        (Paper(step=0.05), 0.1, 0.65),
        (Paper(step=0.05), 0.2, 0.65),
        (Paper(step=0.05), 0.3, 0.55),
        (Stall(step=0.05), 0.1, 0.55),
        (Stall(step=0.05), 0.2, 0.65),
        (Stall(step=0.05), 0.3, 0.65),
        (Fixed(), 0.1, 0.6),
        (Fixed(), 0.2, 0.6),
        (Fixed(), 0.3, 0.6),
    ],
)
def test_each_rule_moves_as_it_is_written(rule: Temperature, best: float, expected: float) -> None:
    """From T = 0.6 and a best of 0.2: a better best, an equal one, a worse one."""
    assert rule.next(ended(0.6, best, 0.2)) == expected


@given(st.sampled_from([Paper, Stall]), st.floats(0, 1), LOSSES, LOSSES, st.floats(0, 1))
def test_temperature_stays_in_its_range(
    rule: type[Paper] | type[Stall], temperature: float, best: float, best_before: float, step: float
) -> None:
    """Whatever happens, the next temperature is in [0, 1]."""
    assert 0 <= rule(step=step).next(ended(temperature, best, best_before)) <= 1


def test_steps_gather_no_dust() -> None:
    """Twenty steps of 0.05 up from 0 make 1, and eight up from 0.6 do as well, with every step a round number."""
    reached = [0.0]
    for _ in range(20):
        reached.append(Paper(step=0.05).next(ended(reached[-1], 0, 0)))
    assert reached == [round(0.05 * step, 12) for step in range(21)]
