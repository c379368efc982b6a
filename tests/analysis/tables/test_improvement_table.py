"""Promise: no improvement is shown without its re-estimate once there is one, and what other seeds give is in words."""

from hand_runs import altered, closed, elite, run, trained
from studies import LOSSES, reestimates

from analysis.table import Percent
from analysis.tables.dynamics import OTHER_SEEDS, improvement_table
from tacevo.results.run import RecordedRun


def searched() -> RecordedRun:
    """Return a run that found the winner: 20 % below its baseline."""
    elites = [elite("g01s00", niche=0, fitness=0.4)]
    return run([trained(0, 0, 0.5), trained(1, 0, 0.4)], [closed(0, 0.5), closed(1, 0.4)], elites=elites)


def test_improvement_stands_beside_the_trivial_loss() -> None:
    """In the first row; a search at chance is said to be one in the first note."""
    for trivial, is_chance in ((0.41, True), (0.6, False), (None, False)):
        table = improvement_table(altered(searched(), trivial=trivial))
        assert (table.rows[0] == ("trivial loss", trivial)) == (trivial is not None)
        assert table.notes[0].startswith("At chance: ") == is_chance


def test_improvement_is_one_draw_until_it_is_re_estimated() -> None:
    """Then the re-estimate stands below it: 20 % by one draw is a third worse by the medians of three seeds."""
    alone, beside = improvement_table(searched()), improvement_table(searched(), [reestimates()])
    draw = (
        "Every fitness, a validation loss, is one draw, the lowest loss of one seed, and the best is the lowest of "
        "many."
    )
    assert alone.notes == beside.notes == (f"{draw} {OTHER_SEEDS}",)
    words = "re-estimated by a noise run, median of 3 other seeds"
    assert beside.rows == (
        *alone.rows,
        (f"fitness of the baseline, {words}", 0.6),
        (f"best fitness, g01s00, {words}", 0.8),
        (f"improvement over the baseline, {words}", Percent((0.6 - 0.8) / 0.6)),
    )


def test_improvement_is_re_estimated_by_the_most_seeds_that_have_the_best_network() -> None:
    """Not by more seeds of other networks, nor by fewer."""
    few = reestimates([one[:2] for one in LOSSES], name="a")
    other = reestimates([[0.5] * 9], name="b")
    rows = improvement_table(searched(), [few, other, reestimates(name="c")]).rows
    assert str(rows[-1][0]).endswith("median of 3 other seeds")
