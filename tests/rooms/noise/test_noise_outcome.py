"""Promise: a noise run ends with one table that says what it found, and in words how sure that is."""

from dataclasses import replace

import pytest
from studies import estimated, network

from analysis.studies.noise import SeedNoise
from analysis.table import Interval
from analysis.tables.noise import noise_table
from analysis.tables.noise_outcome import MOST, noise_outcome

ONE_DRAW = "fitness, one draw"


def test_noise_run_stands_beside_the_trivial_loss() -> None:
    """In the last row; where no median is better by the margin, the first note says that."""
    again = estimated(["baseline", "variant 1"], [[1.0, 1.2], [0.96, 0.98]])
    for trivial, is_chance in ((1.0, True), (1.1, False), (None, False)):
        for table in (noise_outcome(again, "force", trivial), noise_table(again, "force", trivial)):
            assert table.notes[0].startswith("At chance: ") == is_chance
            last = dict(zip(table.columns, table.rows[-1], strict=True))
            assert (last["network"] == "trivial") == (trivial is not None)
            assert trivial is None or trivial in last.values()


def test_noise_run_lists_the_baseline_the_winner_and_the_best_by_re_estimate() -> None:
    """On one screen, however many elites there are; what is not listed is counted."""
    names = ["baseline", *(f"variant {number}" for number in range(1, 31))]
    again = estimated(names, [[1.0, 1.2], *([2.0 - 0.01 * at, 2.1 - 0.01 * at] for at in range(30))])
    table = noise_outcome(again, "force", None)
    listed = [row[0] for row in table.rows]
    assert listed == ["baseline", "variant 1", *names[-(MOST - 2) :]]
    assert any(f"Not listed: {31 - MOST}" in note for note in table.notes)
    winner = dict(zip(table.columns, table.rows[1], strict=True))
    assert winner[ONE_DRAW] == 0.1
    assert (winner["re-estimated"], winner["least"], winner["most"]) == (2.05, 2.0, 2.1)
    assert isinstance(winner["chance to beat the baseline [95 %]"], Interval)
    icc = SeedNoise(again).icc
    assert icc is not None
    assert table.notes[-1].startswith(f"ICC {icc.estimate:.3f} [")


def test_noise_run_of_a_baseline_alone_has_no_icc() -> None:
    """Which the note says; nothing is compared."""
    table = noise_outcome(estimated(["baseline"], [[1.0, 1.2]]), "force", None)
    assert [row[-1] for row in table.rows] == [None]
    assert table.notes[-1].startswith("No ICC")


#: Losses of the baseline under eight other seeds.
BASELINE = [0.80, 0.81, 0.82, 0.83, 0.84, 0.85, 0.86, 0.87]


@pytest.mark.parametrize(
    ("shift", "words"),
    [
        (
            -0.4,
            "The search's best network beats the baseline: median loss 0.435 (id of variant 1) against 0.835, over 8 ",
        ),
        (0.005, "The search's best network cannot be said to beat the baseline, whose median loss is 0.835 over 8 "),
        (0.4, "did not use: 1 is worse."),
    ],
)
def test_noise_run_begins_with_its_finding(shift: float, words: str) -> None:
    """Whether the winner on record is better, worse or neither rests on the interval."""
    best = [loss + shift for loss in BASELINE]
    table = noise_outcome(estimated(["baseline", "variant 1"], [BASELINE, best]), "force", None)
    assert words in table.caption
    assert table.notes[0] == "force: 2 networks, trained again as the search did, with 8 other seeds."
    assert not any("for all elites together" in note for note in table.notes)


def test_finding_of_several_names_those_that_are_better() -> None:
    """Best first by re-estimate; the others are counted, and none is left out."""
    near, far = [loss + 0.005 for loss in BASELINE], [loss + 0.4 for loss in BASELINE]
    good, best = [loss - 0.4 for loss in BASELINE], [loss - 0.5 for loss in BASELINE]
    names = ["baseline", *(f"variant {number}" for number in range(1, 5))]
    table = noise_outcome(estimated(names, [BASELINE, good, near, far, best]), "force", None)
    assert sum("for all elites together" in note for note in table.notes) == 1
    assert table.caption == (
        "2 of the search's 4 best networks beat the baseline: median loss 0.335 (id of variant 4) and 0.435 (id of "
        "variant 1) against 0.835, over 8 seeds that the search did not use; 1 cannot be told from it; 1 is worse."
    )
    both = noise_outcome(estimated(names[:3], [BASELINE, good, best]), "force", None).caption
    assert both.startswith("Both of the search's best networks beat the baseline: ")


def test_failed_elites_are_not_counted() -> None:
    """Neither among the best, nor silently."""
    again = replace(estimated(["baseline", "a", "b"], [BASELINE] * 3), failed=(network("c"),))
    assert noise_outcome(again, "force", None).caption.startswith(
        "None of the search's 2 best networks that trained with every seed can be said"
    )


@pytest.mark.parametrize(("seeds", "others", "is_enough"), [(5, 5, True), (5, 10, False), (3, 1, True), (2, 1, False)])
def test_too_few_seeds_are_named(seeds: int, others: int, *, is_enough: bool) -> None:
    """Where not even all wins would tell, the verdict says nothing of the networks."""
    names = ["baseline", *map(str, range(others))]
    table = noise_outcome(estimated(names, [[1.0] * seeds, *[[0.1] * seeds] * others]), "force", None)
    assert any("cannot tell any of" in note for note in table.notes) == (not is_enough)
    assert ("be said to beat" in table.caption) == (not is_enough)


def test_more_networks_need_more_evidence() -> None:
    """What is better alone is not, where it is one of many that might have been lucky."""
    wins = [loss - 0.04 for loss in BASELINE]
    clear = noise_outcome(estimated(["baseline", "a"], [BASELINE, wins]), "force", None).caption
    names = ["baseline", *map(str, range(50))]
    crowded = noise_outcome(estimated(names, [BASELINE, *[wins] * 50]), "force", None).caption
    assert "beats the baseline" in clear
    assert crowded.startswith("None of the search's 50 best networks can")
