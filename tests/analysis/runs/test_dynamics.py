"""The dynamics of a search are the counts that a person would make from its ledger."""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hand_runs import closed, rejected, run, trained

from analysis.runs.dynamics import (
    GENERATIONS,
    PRODUCTIVITY,
    by_prompt,
    by_temperature,
    improvement,
    progress,
    repeats,
)
from analysis.table import Interval, Percent
from analysis.tables.dynamics import (
    costs_table,
    gate_table,
    generations_table,
    improvement_table,
    prompts_table,
    temperatures_table,
)
from tacevo.costs import Spending
from tacevo.evolution.archive import AddStatus
from tacevo.evolution.lines import CandidateLine, gate_stages
from tacevo.records import Reason, Stage
from tacevo.results.run import RecordedRun
from tacevo.results.summary import rates_in_words
from tacevo.storage.run_directory import RunDirectory

CENTROIDS = np.array([[0.25, 0.5], [0.75, 0.5]])

PAID = Spending(answers=1, input_tokens=100, output_tokens=50, usd=0.25)


def two_generations() -> RecordedRun:
    """Return a run whose every figure can be counted on one hand."""
    return run(
        [
            trained(0, 0, 0.8),
            trained(0, 1, 0.6),
            trained(1, 0, 0.4, prompt=0, status=AddStatus.improved),
            trained(1, 1, 0.9, prompt=0, status=AddStatus.rejected, source="g00s01"),
            rejected(1, 2, Stage.policy, Reason.forbidden_import, prompt=1),
            trained(1, 3, 0.5, prompt=None, parents=("g00s00", "g00s01"), source="g00s00", status=AddStatus.rejected),
        ],
        [closed(0, 0.6, candidates=2, trained=2, coverage=0.5), closed(1, 0.4, candidates=4, trained=3, coverage=0.75)],
        spent=dict.fromkeys(("g00s01", "g01s00", "g01s01"), PAID),
    )


def test_generation_is_counted() -> None:
    """Elites follow from coverage and niches, growth from the generation before, rejections stand by stage."""
    first, second = progress(two_generations()).itertuples()
    assert (first.elites, first.growth, second.elites, second.growth) == (2, 2, 3, 1)
    assert (second.new, second.improved, second.repeated, second.unchanged) == (0, 1, 2, 1)
    rejected = {stage: getattr(second, f"rejected_{stage}") for stage in Stage}
    assert rejected == {Stage.extract: 0, Stage.policy: 1, Stage.probe: 0, Stage.train: 0}


def test_niches_that_bounds_emptied_are_lost() -> None:
    """Three niches are occupied, one candidate finds a fourth, and two are left: two were lost."""
    slots = [trained(0, 0), trained(0, 1), trained(0, 2), trained(1, 0)]
    moved = run(slots, [closed(0, coverage=0.75), closed(1, coverage=0.5)])
    assert progress(moved).lost.tolist() == [0, 2]


def test_repeat_is_an_evaluation_that_was_asked_for_before() -> None:
    """The first slot of a source is none, every later one is, in whatever generation."""
    slots = [trained(0, 0), trained(0, 1, source="twin"), trained(0, 2, source="twin"), trained(1, 0, source="twin")]
    assert repeats(run(slots, [])) == {"g00s02", "g01s00"}


def test_copy_is_the_source_of_a_parent() -> None:
    """A child that equals a candidate which is not its parent is not a copy."""
    slots = [trained(0, 0), trained(0, 1), trained(1, 0, source="g00s00"), trained(1, 1, source="g00s01")]
    assert run(slots, []).copies == {"g01s00"}


def test_copy_may_have_other_words_and_another_layout(tmp_path: Path) -> None:
    """Comments and docstrings make no other network, and a file that was edited shows none."""
    parent = "class Net:\n    def forward(self, x):\n        return x\n"
    sources = {
        "g00s00": parent,
        "g01s00": parent.replace("    def", '    """The same."""\n\n    def').replace(
            "return x", "return (x)  # as it is"
        ),
        "g01s01": parent.replace("return x", "return -x"),
        "g01s02": parent.replace("return x", "return  x"),
    }
    slots = [trained(int(name[2]), int(name[5]), source=hashed(text)) for name, text in sources.items()]
    made = replace(run(slots, [closed(0), closed(1, candidates=3)]), directory=RunDirectory(tmp_path))
    (tmp_path / "candidates").mkdir()
    for name, text in sources.items():
        edited = text + "x = 1\n" if name == "g01s02" else text
        (tmp_path / "candidates" / f"{name}.py").write_text(edited, encoding="utf-8")
    assert made.copies == {"g01s00"}
    assert progress(made).unchanged.tolist() == [0, 1]
    assert any(line.startswith("Unchanged: 1 answer ") for line in rates_in_words(made))
    table = generations_table(made, CENTROIDS)
    assert table.rows[-1][table.columns.index("unchanged")] == 1


def hashed(text: str) -> str:
    """Return the hash by which a ledger names a source."""
    return hashlib.sha256(text.encode()).hexdigest()


def test_costs_with_a_gap_are_unknown() -> None:
    """A sum that misses an answer would pass for the whole; the baseline was nobody's answer."""
    spent = progress(two_generations())[["answers", "tokens", "input_tokens", "output_tokens", "usd"]]
    assert tuple(spent.loc[0]) == (1, 150, 100, 50, 0.25)
    assert spent.loc[1].isna().all()
    assert costs_table(two_generations()).rows == ((0, 1, 100, 50, 0.25), (1, None, None, None, None))


def test_dollars_are_shown_only_where_every_answer_has_a_price() -> None:
    """Tokens are known without a price."""
    unpriced = Spending(answers=1, input_tokens=7, output_tokens=3, unpriced=1)
    spender = run([trained(0, 0), trained(0, 1)], [closed(0)], spent={"g00s01": unpriced})
    assert costs_table(spender).rows == ((0, 1, 7, 3, None),)


def test_gate_counts_what_each_stage_leaves() -> None:
    """Shares are of all first answers, and the last stage leaves what was trained; the baseline was nobody's answer."""
    slots = [
        trained(0, 0),
        trained(0, 1),
        rejected(1, 0, Stage.extract, Reason.empty),
        rejected(1, 1, Stage.probe, Reason.bad_output),
        rejected(1, 2, Stage.probe, Reason.forward_failed),
        rejected(1, 3, Stage.probe, Reason.forward_failed),
    ]
    extract, policy, probe, train = gate_stages(slots)
    assert [(stage.rejected, stage.left) for stage in (extract, policy, probe, train)] == [
        (1, 4),
        (0, 4),
        (3, 1),
        (0, 1),
    ]
    assert probe.reasons == ((Reason.forward_failed, 2), (Reason.bad_output, 1))
    assert train.left_share == 0.2
    assert gate_table(run(slots, [])).rows[2] == ("probe", 3, 1, Percent(0.2), "forward_failed 2, bad_output 1")


def test_gate_table_counts_misreporting_candidates() -> None:
    """The words are those of the summary; a run without any has no note."""
    slots = [
        trained(0, 0),
        rejected(1, 0, Stage.policy, Reason.changes_its_weights),
        rejected(1, 1, Stage.probe, Reason.changes_its_weights),
        rejected(1, 2, Stage.probe, Reason.crashed),
    ]
    (note,) = gate_table(run(slots, [])).notes
    assert note == "Rejected for misreporting themselves (docs/gate.md): 2 (changes_its_weights 2)."
    assert gate_table(two_generations()).notes == ()


def test_repaired_answer_counts_as_rejected_once_at_first() -> None:
    """The paper discards a failed answer, so a rate that counts corrected ones could not stand beside its rate."""
    mended = trained(1, 0, repairs=((Stage.extract, Reason.no_class), (Stage.probe, Reason.bad_output)))
    stages = gate_stages([trained(0, 0), mended])
    assert [stage.rejected for stage in stages] == [1, 0, 0, 0]


def test_rejected_child_was_tried_and_inserted_nowhere() -> None:
    """An instruction that yields broken code is unproductive; crossovers and generation 0 do not count."""
    refine, widen = by_prompt(two_generations()).itertuples()
    assert (refine.tried, refine.trained, refine.inserted) == (2, 2, 1)
    assert (widen.tried, widen.trained, widen.inserted, widen.rate) == (1, 0, 0, 0.0)


def skipped(generation: int, slot: int, *, prompt: int) -> CandidateLine:
    """Make a mutation that a surrogate skipped."""
    nothing: dict[str, Any] = dict.fromkeys(("evaluation", "fitness", "validation_losses", "niche", "status"))
    return replace(trained(generation, slot, prompt=prompt), skipped=True, **nothing)


def test_skipped_candidate_counts_for_nothing_and_stands_apart() -> None:
    """It is no failure of the gate, of its instruction or of the search; other runs have no column for it."""
    plain = two_generations()
    more = [skipped(1, 4, prompt=0), skipped(1, 5, prompt=1)]
    closing = replace(plain.generations[1], candidates=6, skipped=2)
    told = run([*plain.candidates, *more], [plain.generations[0], closing])
    assert by_prompt(told).equals(by_prompt(plain))
    assert by_temperature(told).equals(by_temperature(plain))
    assert progress(told).skipped.tolist() == [pd.NA, 2]
    assert improvement(told).trainable == (3 + 2) / 6
    assert improvement(told)[["new_quartile", "new_median"]].equals(improvement(plain)[["new_quartile", "new_median"]])
    assert gate_stages(told.candidates)[-1].left == gate_stages(plain.candidates)[-1].left + 2
    (note,) = gate_table(told).notes
    assert note.endswith(": 2.")
    told_columns, plain_columns = (generations_table(one, CENTROIDS).columns for one in (told, plain))
    assert [*told_columns] == [*plain_columns[:4], "skipped", *plain_columns[4:]]


@pytest.mark.room("alarms")
def test_skipped_candidates_ring_no_alarm() -> None:
    """Neither do they fail the gate, nor is an instruction untried whose children were all skipped."""
    from analysis.runs.health import alarms

    told = run([trained(0, 0), trained(1, 0, prompt=0), skipped(1, 1, prompt=1)], [closed(0), closed(1)])
    assert by_prompt(told).tried.tolist() == [1, 0]
    assert not [alarm.name for alarm in alarms(told, CENTROIDS) if alarm.name.startswith(("untried", "strict"))]


def test_interval_is_the_one_of_wilson() -> None:
    """1 of 2: centre (p + z^2 / 2n) / (1 + z^2 / n), half width z / (1 + z^2 / n) sqrt(p (1 - p) / n + z^2 / 4 n^2)."""
    z, n, p = 1.959963984540054, 2, 0.5
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * (p * (1 - p) / n + z * z / (4 * n * n)) ** 0.5
    prompts = by_prompt(two_generations())
    assert prompts.loc[0, ["rate_low", "rate_high"]].tolist() == pytest.approx((centre - half, centre + half))
    assert prompts.rate_low[1] == 0.0  # of no success, not a hair beside it


def test_instruction_that_was_never_tried_has_no_rate() -> None:
    """It has a row, with the index by which the map of prompts is read, and without a value."""
    untried = by_prompt(run([trained(0, 0)], [])).loc[1]
    assert (untried["name"], untried.tried) == ("widen", 0)
    assert untried[["rate", "rate_low", "rate_high"]].isna().all()
    assert prompts_table(run([trained(0, 0)], [])).rows[1] == (1, "widen", 0, 0, 0, None)


@pytest.mark.parametrize(
    ("temperature", "band"), [(0.0, "0.0-0.1"), (0.3, "0.3-0.4"), (0.6, "0.6-0.7"), (0.7, "0.7-0.8"), (1.0, "0.9-1.0")]
)
def test_band_holds_its_lower_end(temperature: float, band: str) -> None:
    """Only the last band holds its upper end, too."""
    (one,) = by_temperature(run([trained(0, 0), trained(1, 0, temperature=temperature)], [])).itertuples()
    assert (one.name, one.tried) == (band, 1)
    (row,) = temperatures_table(run([trained(0, 0), trained(1, 0, temperature=temperature)], [])).rows
    assert isinstance(row[4], Interval)


@pytest.mark.parametrize(
    ("temperatures", "told"),
    [
        ((0.6, 0.6, 0.65, 0.7), True),
        ((0.6, 0.9, 0.95, 1.0, 1.0, 1.0), True),
        ((0.6, 0.4, 0.2, 0.0, 0.0), True),
        ((0.6, 0.6, 0.65, 0.6), False),
        ((0.6, 0.6, 0.65, 0.65, 0.7), False),
        ((0.6, 0.95, 1.0, 0.95), False),
        ((1.0, 1.0, 1.0, 1.0), False),
        ((0.6, 0.6, 0.6), False),
        ((0.6, 0.6), False),
    ],
)
def test_table_says_where_temperature_and_generation_are_one(temperatures: tuple[float, ...], told: bool) -> None:
    """Where T moved one way from generation 1 on, but for the end at its limit; not where it turned or stood."""
    lines = [closed(number, temperature=temperature) for number, temperature in enumerate(temperatures)]
    notes = temperatures_table(run([trained(0, 0), trained(1, 0)], lines)).notes
    assert any("temperature and generation are one here" in note for note in notes) is told


def test_improvement_has_both_references() -> None:
    """From 0.8 and 0.6 to 0.4: half of the baseline, a third of the best of generation 0."""
    gains = improvement(two_generations())
    assert (gains.over_baseline, gains.over_first) == pytest.approx((0.5, 1 / 3))
    assert (gains.settled, gains.trainable, gains.coverage) == (1, 0.75, 0.75)


def test_most_of_the_improvement_is_dated() -> None:
    """From 1.0 to 0.0: 0.11 left at generation 7 is not yet 90 %, 0.1 at generation 8 is."""
    bests = [1.0, *(0.5,) * 6, 0.11, 0.1, 0.05, 0.0]
    gains = improvement(run([trained(0, 0, 1.0)], [closed(number, best) for number, best in enumerate(bests)]))
    assert (gains.settled, gains.by_7, gains.by_10) == (8, pytest.approx(0.89), 1.0)


def test_run_without_improvement_settles_nowhere() -> None:
    """Nothing is divided by the improvement that never came."""
    gains = improvement(run([trained(0, 0, 0.5)], [closed(0, 0.5), closed(1, 0.5)]))
    assert (gains.over_first, gains.settled) == (0.0, None)
    assert not {"by_7", "by_10"} & set(gains.index)


def test_run_without_fitness_has_no_improvement() -> None:
    """The table stays empty."""
    nothing = run([rejected(0, 0)], [closed(0, None, trained=0)])
    assert improvement(nothing).empty
    assert improvement_table(nothing).rows == ()


def test_tables_show_the_figures() -> None:
    """One row a generation, in the order of the columns."""
    table = generations_table(two_generations(), CENTROIDS)
    assert dict(zip(table.columns, table.rows[1], strict=True)) == {
        "generation": 1,
        "T": 0.6,
        "candidates": 4,
        "trained": 3,
        "rejected: extract": 0,
        "rejected: policy": 1,
        "rejected: probe": 0,
        "rejected: train": 0,
        "best": 0.4,
        "archive median": 0.4,
        "median of new": 0.4,
        "QD-score": 1.0,
        "coverage": Percent(0.75),
        "elites": 3,
        "growth": 1,
        "lost": -1,
        "new": 0,
        "improved": 1,
        "repeated": 2,
        "unchanged": 1,
    }
    assert ("improvement over the baseline", Percent(0.5)) in improvement_table(two_generations()).rows


def test_frames_have_the_documented_columns_and_types() -> None:
    """Also where nothing was trained or tried, and nothing is known of costs."""
    nothing = run([rejected(0, 0)], [closed(0, None, trained=0)])
    for one in (nothing, two_generations()):
        frames = [(progress(one), GENERATIONS), *((by(one), PRODUCTIVITY) for by in (by_prompt, by_temperature))]
        for frame, columns in frames:
            assert {name: str(kind) for name, kind in frame.dtypes.items()} == columns
    assert progress(nothing).best.isna().all()


def test_new_candidates_are_ranked_with_the_slots_that_gave_none() -> None:
    """Of generations after G / 2 only, each source once and where it came first; a failure is worse than any."""
    candidates = [
        trained(0, 0, 0.1, source="a"),
        trained(1, 1, 0.2),
        trained(2, 0, 0.1, source="a"),
        trained(2, 1, 0.7),
        trained(2, 2, 0.6, source="b"),
        trained(3, 0, 0.6, source="b"),
        trained(3, 1, 0.5),
        trained(3, 2, 0.4),
        rejected(3, 3),
    ]
    ends = [closed(number, 0.1) for number in range(4)]
    gains = improvement(run(candidates, ends))
    assert (gains["new_quartile"], gains["new_median"]) == (0.5, 0.6)
    several = [rejected(3, slot) for slot in range(4, 8)]
    gains = improvement(run([*candidates, *several], ends))
    assert (gains["new_quartile"], gains["new_median"]) == (0.6, None)
