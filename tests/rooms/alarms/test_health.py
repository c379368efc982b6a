"""Each alarm rings for a run made sick on purpose, says the figures, and is silent for a run that is well."""

from dataclasses import replace

import numpy as np
import pytest
from hand_runs import altered, closed, rejected, run, trained
from numpy.typing import NDArray

from analysis.runs.coverage_map import coverage_map, reachable
from analysis.runs.health import alarms
from analysis.tables.health import health_table
from tacevo.evolution.archive import AddStatus
from tacevo.evolution.lines import CandidateLine
from tacevo.records import Reason, Stage
from tacevo.results.run import RecordedRun

#: Four niches, one in each quarter of the unit square.
QUARTERS = np.array([[0.25, 0.25], [0.25, 0.75], [0.75, 0.25], [0.75, 0.75]])

#: A hundred niches, ten by ten.
SIDE = (np.arange(10) + 0.5) / 10
HUNDRED: NDArray[np.float64] = np.stack(np.meshgrid(SIDE, SIDE), axis=-1).reshape(-1, 2)

CORNERS = ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0))


def spread(*points: tuple[float, float], generation: int = 0) -> list[CandidateLine]:
    """Make trained candidates with these descriptors; the first is the baseline where the generation is 0."""
    return [trained(generation, slot, descriptors=point) for slot, point in enumerate(points)]


def well() -> RecordedRun:
    """Return a run in which nothing is wrong."""
    later = [trained(1, slot, prompt=slot, descriptors=(0.2 + slot / 2, 0.5)) for slot in (0, 1)]
    return run([*spread(*CORNERS), *later], [closed(0), closed(1)])


def rung(hand: RecordedRun, centroids: NDArray[np.float64] = QUARTERS) -> list[str]:
    """Name the alarms of a run."""
    return [alarm.name for alarm in alarms(hand, centroids)]


def test_healthy_run_rings_nothing() -> None:
    """And its table says so."""
    assert rung(well()) == []
    table = health_table(well(), QUARTERS)
    assert (table.rows, table.notes) == ((), ("No alarm.",))


def test_outlier_leaves_few_niches_reachable() -> None:
    """All networks but one lie in a corner, so only a sliver of the square lies between them."""
    corner = [(0.0, 0.0), (0.0, 0.2), (0.2, 0.0), (0.2, 0.2), (1.0, 1.0)]
    (alarm,) = [one for one in alarms(run(spread(*corner), [closed(0)]), HUNDRED) if "niches" in one.name]
    assert alarm.name == "few reachable niches"
    figures = alarm.figures
    assert figures["niches"] == 100
    assert figures["share"] == figures["reachable"] / 100 < 0.5


def test_niches_between_networks_are_reachable() -> None:
    """The corners are taken by four networks, and all that lies between them is within reach."""
    placed = coverage_map(run(spread(*CORNERS), [closed(0)]), HUNDRED)
    assert reachable(placed, HUNDRED) == frozenset(range(100))
    triangle = coverage_map(run(spread(*CORNERS[:3]), [closed(0)]), HUNDRED)
    assert 50 <= len(reachable(triangle, HUNDRED)) <= 60


@pytest.mark.parametrize("points", [CORNERS[:1], CORNERS[:2], ((0.0, 0.0), (0.5, 0.5), (1.0, 1.0)), CORNERS[:1] * 4])
def test_nothing_lies_between_networks_on_a_line(points: tuple[tuple[float, float], ...]) -> None:
    """Their own niches are all they reach."""
    placed = coverage_map(run(spread(*points), [closed(0)]), HUNDRED)
    assert reachable(placed, HUNDRED) == frozenset(placed.niches.tolist())


def test_crowded_niche_is_told_with_what_is_left() -> None:
    """Seven of eight candidates in one quarter are worth less than two niches."""
    crowd = [(0.01 * number, 0.01) for number in range(6)]
    raised = alarms(run(spread(*CORNERS[::3], *crowd), [closed(0)]), QUARTERS)
    (alarm,) = (alarm for alarm in raised if alarm.name == "crowded niche")
    figures = alarm.figures
    assert figures["share"] == 7 / 8
    assert figures["effective niches"] == pytest.approx((7 / 8) ** (-7 / 8) * (1 / 8) ** (-1 / 8))


def test_clipped_descriptors_are_told_under_fixed_bounds() -> None:
    """Two of six candidates lie outside."""
    points = [*CORNERS, (0.5, 7.0), (-1.0, 0.2)]
    hand = run(spread(*points), [closed(0)], archive={"bounds": "fixed"})
    (alarm,) = alarms(hand, QUARTERS)
    assert alarm.name == "clipped descriptors"
    assert alarm.figures["share"] == pytest.approx(1 / 3)


def test_logarithmic_axis_is_compared_as_the_archive_has_it() -> None:
    """A ratio of 100 is 2 on that axis, and inside."""
    points = [(0.0, 1.0), (0.0, 100.0), (1.0, 1.0), (1.0, 100.0)]
    fixed = {"bounds": "fixed", "eff_ratio_scale": "log"}
    hand = run(spread(*points), [closed(0)], archive=fixed, bounds=((0.0, 1.0), (0.0, 2.0)))
    assert coverage_map(hand, QUARTERS).points.tolist() == [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]
    assert rung(hand) == []


@pytest.mark.parametrize(("generation", "rings"), [(2, False), (3, True), (4, True)])
def test_bounds_that_move_late_are_told(generation: int, rings: bool) -> None:
    """The last half of four generations begins after the second."""
    mover = trained(generation, 0, prompt=0, descriptors=(2.0, 0.5))
    lines = [closed(number) for number in range(5)]
    hand = run([*spread(*CORNERS), mover], lines, bounds=((0.0, 2.0), (0.0, 1.0)), instructions=["refine"])
    assert ("late bounds" in rung(hand)) is rings
    assert coverage_map(hand, QUARTERS).moved[-1] == generation


def test_late_bounds_say_how_many_niches_they_emptied() -> None:
    """Four new candidates and one that moved the bounds, and two occupied niches are left: three were lost."""
    mover = trained(1, 0, prompt=0, descriptors=(9.0, 0.5))
    lines = [closed(0, coverage=1.0), closed(1, coverage=0.5)]
    hand = run([*spread(*CORNERS), mover], lines, bounds=((0.0, 9.0), (0.0, 1.0)))
    (alarm,) = (alarm for alarm in alarms(hand, QUARTERS) if alarm.name == "late bounds")
    assert alarm.figures["lost niches"] == 3
    assert "emptied 3 niches" in alarm.sentence


def test_fixed_bounds_never_move() -> None:
    """A candidate outside is clipped, and the archive stands."""
    hand = run(spread(*CORNERS, (5.0, 5.0)), [closed(0)], archive={"bounds": "fixed"})
    assert coverage_map(hand, QUARTERS).moved == ()


@pytest.mark.parametrize(("axis", "name"), [(0, "constant ArchDiv"), (1, "constant EffRatio")])
def test_axis_that_tells_nothing_apart_is_named(axis: int, name: str) -> None:
    """One outlier sets its bounds, and all others lie together."""
    points = [(0.5, number / 40) for number in range(40)] + [(0.0, 0.5), (1.0, 1.0)]
    hand = run(spread(*(point if axis == 0 else (point[1], point[0]) for point in points)), [closed(0)])
    assert name in rung(hand)


def outlying(axis: int, *, low: float = 1.0, high: float = 10_000.0) -> list[CandidateLine]:
    """Make forty candidates that lie evenly along the logarithm of one axis, and evenly along the other."""
    steps = np.linspace(0.0, 1.0, 40)
    points = [(float(step), float(low * (high / low) ** step)) for step in steps]
    return spread(*(point if axis == 1 else point[::-1] for point in points))


def concentrated(hand: RecordedRun) -> dict[str, tuple[str, dict[str, float]]]:
    """Return the sentences and figures of the alarms of concentration, by their names."""
    raised = (alarm for alarm in alarms(hand, HUNDRED) if alarm.name.startswith("concentrated"))
    return {alarm.name: (alarm.sentence, dict(alarm.figures)) for alarm in raised}


def test_concentration_names_axis_share_and_what_helps() -> None:
    """Thirty of forty networks lie below a tenth of the greatest ratio; on a logarithmic axis a tenth holds four."""
    hand = run(outlying(1), [closed(0)], bounds=((0.0, 1.0), (1.0, 10_000.0)))
    assert concentrated(hand) == {
        "concentrated EffRatio": (
            "75 % of the trained candidates lie in a tenth of the range of EffRatio, where few niches distinguish "
            "them; under archive.eff_ratio_scale=log the fullest tenth would hold 10 %.",
            {"share": 0.75, "share under log": 0.1},
        )
    }


def test_logarithm_is_advised_only_where_it_helps() -> None:
    """Not for the other axis, nor where the axis is logarithmic already, has fixed bounds, or would stay as crowded."""
    narrower = "archive.bounds=fixed with narrower archive.{}_bounds would spread them."
    steep = ((0.0, 1.0), (1.0, 10_000.0))
    other = concentrated(run(outlying(0), [closed(0)], bounds=steep[::-1]))
    assert other["concentrated ArchDiv"][0].endswith(narrower.format("arch_div"))
    fixed = concentrated(run(outlying(1), [closed(0)], bounds=steep, archive={"bounds": "fixed"}))
    assert fixed["concentrated EffRatio"][0].endswith(narrower.format("eff_ratio"))
    twins = spread(*[(step / 40, 1.0) for step in range(40)], (1.0, 10_000.0))
    same = concentrated(run(twins, [closed(0)], bounds=steep))
    assert same["concentrated EffRatio"][0].endswith(narrower.format("eff_ratio"))


def test_axis_that_is_filled_evenly_is_not_concentrated() -> None:
    """A logarithmic axis of the networks that crowd a linear one."""
    log = run(outlying(1), [closed(0)], bounds=((0.0, 1.0), (0.0, 4.0)), archive={"eff_ratio_scale": "log"})
    assert concentrated(log) == {}


def test_duplicates_are_told_once_a_slot() -> None:
    """A child that is its parent and was seen before is one duplicate; the baseline is none."""
    same = [trained(1, slot, prompt=slot, source="g00s00", descriptors=(0.5, slot / 2)) for slot in (0, 1)]
    (alarm,) = alarms(run([*spread(*CORNERS), *same], [closed(0), closed(1)]), QUARTERS)
    assert alarm.name == "many duplicates"
    assert alarm.figures == {"duplicates": 2, "answers": 5, "share": 0.4}


def test_strict_stage_is_told_with_its_commonest_reason() -> None:
    """Two of six first answers had no class."""
    lost = [rejected(1, slot, Stage.extract, Reason.no_class, prompt=slot) for slot in (0, 1)]
    hand = run([*spread(*CORNERS), *lost], [closed(0), closed(1)])
    (alarm,) = alarms(hand, QUARTERS)
    assert alarm.name == "strict gate: extract"
    assert alarm.sentence.endswith("most often for no_class (2).")


def test_samples_without_parents_are_answers_too() -> None:
    """Under `ablation=random_sampling` no answer has a parent: the gate rejected two of five."""
    samples = [replace(line, parents=()) for line in spread(*CORNERS)]
    lost = [replace(rejected(1, slot, Stage.extract, Reason.no_class, prompt=slot), parents=()) for slot in (0, 1)]
    (alarm,) = alarms(run([*samples, *lost], [closed(0), closed(1)]), QUARTERS)
    assert alarm.figures == {"rejected": 2, "share": 0.4}


def test_untried_prompts_are_named() -> None:
    """Only once prompts were drawn at all."""
    hand = run([*spread(*CORNERS), trained(1, 0, prompt=1)], [closed(0), closed(1)])
    (alarm,) = alarms(hand, QUARTERS)
    assert (alarm.name, alarm.sentence) == ("untried prompts", "Never drawn (prompts=uniform): refine.")
    assert rung(run(spread(*CORNERS), [closed(0)])) == []


@pytest.mark.parametrize(("tries", "rings"), [(3, False), (12, True)])
def test_fruitless_prompt_is_told_from_bad_luck(tries: int, rings: bool) -> None:
    """Where every other child of the rest came in, three failures may be chance, twelve are not."""
    good = [
        trained(1, slot, prompt=0, status=(AddStatus.new, AddStatus.rejected)[slot % 2], descriptors=(slot / 6, 0.5))
        for slot in range(6)
    ]
    bad = [
        trained(1, 6 + slot, prompt=1, status=AddStatus.rejected, descriptors=(slot / tries, slot / tries))
        for slot in range(tries)
    ]
    hand = run([*spread(*CORNERS), *good, *bad], [closed(0), closed(1)])
    assert ("fruitless prompt" in rung(hand)) is rings


@pytest.mark.parametrize(
    ("temperatures", "rings"),
    [((0.9, 1.0, 1.0, 1.0), True), ((0.9, 0.95, 1.0, 1.0), False), ((0.0, 0.0, 0.0, 0.1), False), ((0.6,) * 4, False)],
)
def test_temperature_at_its_limit_is_told(temperatures: tuple[float, ...], rings: bool) -> None:
    """Where it stands there for three generations, and to the end."""
    lines = [closed(number, temperature=temperature) for number, temperature in enumerate(temperatures)]
    assert ("stuck temperature" in rung(run(spread(*CORNERS), lines))) is rings


def test_run_that_trained_nothing_has_no_niches_to_look_at() -> None:
    """Its gate is told all the same; whoever asks for its places is refused."""
    hand = run([rejected(0, 1)], [closed(0, None, trained=0)], bounds=None)
    assert rung(hand) == ["strict gate: probe"]
    with pytest.raises(ValueError, match="has no bounds, because nothing was trained"):
        coverage_map(hand, QUARTERS)


@pytest.mark.parametrize(
    ("seconds", "rings"),
    [
        ((10, 10, 10, 10, 10, 10), False),
        ((10, 11, 9, 10, 10, 220), True),
        ((10, 11, 9, 10, 10, 49), False),
        ((10, 11, 9, 10), False),
    ],
)
def test_processor_time_that_operations_do_not_explain_is_told(seconds: tuple[float, ...], rings: bool) -> None:
    """A candidate that trains more than it was asked to takes that time; few trainings show nothing usual."""
    lines = [trained(0, slot, descriptors=CORNERS[slot % 4]) for slot in range(len(seconds))]
    lines = [replace(line, flops=1_000_000) for line in lines]
    hand = altered(run(lines, [closed(0)]), cpu_seconds={f"g00s{i:02}": taken for i, taken in enumerate(seconds)})
    told = [alarm for alarm in alarms(hand, QUARTERS) if alarm.name == "unexplained processor time"]
    assert bool(told) is rings
    if rings:
        assert told[0].figures == {"g00s05": 22.0}


def test_large_network_may_take_long() -> None:
    """Ten times the operations explain ten times the time, also where they run in training only."""
    lines = [replace(trained(0, slot, descriptors=CORNERS[slot % 4]), flops=1_000_000) for slot in range(6)]
    lines[5] = replace(lines[5], extra_flops=9_000_000)
    taken = {line.id: 10.0 for line in lines} | {lines[5].id: 100.0}
    assert "unexplained processor time" not in rung(altered(run(lines, [closed(0)]), cpu_seconds=taken))
