"""Promise: a candidate stands on a run's front by the best fitness that is known of it, and what that is is said."""

from dataclasses import replace

import pytest
from hand_runs import closed, run, trained

from analysis.runs.pareto import PARETO, beside_costs, hypervolumes, on_front, reference_point
from analysis.tables.pareto import pareto_table
from tacevo.evolution.lines import CandidateLine


def costing(line: CandidateLine, flops: int) -> CandidateLine:
    """Return a candidate that costs so much."""
    return replace(line, flops=flops)


#: The baseline, one that is better and dearer, one worse and cheaper, one that is beaten, and a copy of the first one.
SLOTS = [
    costing(trained(0, 0, 0.8), 40),
    costing(trained(0, 1, 0.4), 80),
    costing(trained(1, 0, 0.9), 20),
    costing(trained(1, 1, 0.6), 100),
    costing(trained(1, 2, 0.4, source="g00s01"), 80),
]
RUN = run(SLOTS, [closed(0, 0.4, candidates=2), closed(1, 0.4, candidates=3)])
OBJECTIVES = ["fitness", "flops"]


def test_front_has_its_columns_and_order() -> None:
    """The lowest fitness first; of equal candidates the earlier one; a run without trained ones has an empty front."""
    front = on_front(beside_costs(RUN, {}), OBJECTIVES)
    assert front.index.tolist() == ["g00s01", "g00s00", "g01s00"]
    assert set(front.estimate) == {"one draw"}
    for frame in (front, on_front(beside_costs(run([], [closed(0, None)]), {}), OBJECTIVES)):
        assert {name: str(dtype) for name, dtype in frame.dtypes.items()} == PARETO


def test_reestimate_takes_the_place_of_a_draw() -> None:
    """Of every candidate of that source, by the median; the others stay what the search knew, and it is said."""
    costs = beside_costs(RUN, {"g00s01": (0.7, 0.9, 0.75)})
    assert costs.fitness.tolist() == [0.8, 0.75, 0.9, 0.6, 0.75]
    assert costs.estimate.tolist() == ["one draw", "re-estimated", "one draw", "one draw", "re-estimated"]
    assert costs.draws.tolist() == [1, 3, 1, 1, 3]
    assert on_front(costs, OBJECTIVES).index.tolist() == ["g01s01", "g00s01", "g00s00", "g01s00"]


def test_hypervolume_grows_from_the_baseline_and_the_largest_cost() -> None:
    """By hand, of the box of 0.8 by 100; one that is no better than the baseline adds nothing."""
    assert reference_point(RUN) == (0.8, 100)
    assert hypervolumes(RUN) == pytest.approx([0.5 * 0.2] * 2)
    cheap = run([*SLOTS, costing(trained(2, 0, 0.4), 10)], [*RUN.generations, closed(2, 0.4)])
    assert hypervolumes(cheap) == pytest.approx([0.1, 0.1, 0.5 * 0.9])


def test_run_without_a_baseline_that_trained_has_no_hypervolume() -> None:
    """A value is missing, and not 0."""
    assert hypervolumes(run([], [closed(0, None)])) == [None]


def test_table_warns_of_draws_that_were_lucky() -> None:
    """Unless every network of the front was trained again; it names the reference point."""
    lucky = pareto_table(RUN, {"g00s01": (0.7, 0.9, 0.75)})
    assert any("by luck" in note for note in lucky.notes)
    again = pareto_table(RUN, {str(line.source): (line.fitness or 0.0,) for line in SLOTS})
    assert not any("flatters" in note for note in again.notes)
    assert "0.800" in again.notes[-1]
