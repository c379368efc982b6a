"""Promise: re-estimates choose a network of each search, and other trainings than these compare what was chosen."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.multitest import multipletests
from studies import around, network, study_of

from analysis.report.collection import side_by_side
from analysis.studies.reestimates import Reestimates
from analysis.studies.searches import CHOSEN, StudiedSearch, best_by_reestimates
from analysis.table import Interval
from analysis.tables.rendering import as_markdown
from analysis.tables.searches import searches_table
from tacevo.records import Kind

#: Test accuracies of the searches' networks.
BASELINE, GOOD, BETTER = around(0.5, step=0.01), around(0.7, step=0.01), around(0.8, step=0.01)

#: Losses of twenty seeds that choose one of several networks.
HIGH, MIDDLE, LOW = around(0.9, step=0.001), around(0.5, step=0.001), around(0.3, step=0.001)


def studied(
    name: str,
    scores: Mapping[str, Sequence[float]],
    losses: Mapping[str, Sequence[float]],
    kind: Kind = Kind.classification,
) -> StudiedSearch:
    """Make a search by the test scores and the re-estimates of its networks; each has a record of 0.1."""
    estimates = np.array(list(losses.values()))
    networks = tuple(replace(network(one), id=f"{name}{place}") for place, one in enumerate(losses))
    again = Reestimates(
        name="study1",
        networks=networks,
        estimates=tuple(map(tuple, estimates.tolist())),
        epochs=5,
    )
    study = replace(study_of(scores, kind=kind), run=name, networks=networks)
    return StudiedSearch(name=name, study=study, reestimates=again)


FIRST = studied("grammar", {"baseline": BASELINE, "variant 1": GOOD}, {"baseline": HIGH, "variant 1": MIDDLE})
SECOND = studied(
    "model",
    {"baseline": BASELINE, "variant 1": BETTER, "variant 2": GOOD},
    {"baseline": HIGH, "variant 1": MIDDLE, "variant 2": LOW},
)


@pytest.mark.parametrize("half", [0, 1])
def test_re_estimates_choose_and_test_scores_do_not(half: int) -> None:
    """The second search has a network that tests better; it was not to be known when it was chosen."""
    chosen = best_by_reestimates([FIRST, SECOND], half=half)
    assert {name: str(kind) for name, kind in chosen.dtypes.items()} == CHOSEN
    assert chosen.network.tolist() == ["variant 1", "variant 2"]
    assert chosen.reestimated[0] == pytest.approx(np.median(MIDDLE[1 - half :: 2]))
    assert chosen.tested[1] == pytest.approx(np.median(GOOD[1 - half :: 2]))
    compared = chosen[["lower_loss", "difference", "p_holm"]]
    assert compared.loc[0].isna().all()
    assert tuple(compared.loc[1]) == (1, 0, 1)


def test_luck_that_chooses_a_network_does_not_count_for_it() -> None:
    """Two networks whose odd and even seeds are lucky in turn: what was chosen is judged by the unlucky ones."""
    lucky, unlucky = [0.1, 0.9] * 10, [0.9, 0.1] * 10
    search = studied(
        "luck",
        {"variant 1": [0.9, 0.5] * 10, "variant 2": [0.5, 0.9] * 10},
        {"variant 1": lucky, "variant 2": unlucky},
    )
    for half, name in enumerate(("variant 1", "variant 2")):
        chosen = best_by_reestimates([FIRST, search], half=half).loc[1]
        assert tuple(chosen[["network", "reestimated", "tested"]]) == (name, 0.9, 0.5)


def test_baseline_that_nothing_beats_is_chosen() -> None:
    """A search that found nothing says so by it; so does one whose network is as good as the baseline."""
    scores = {"baseline": BASELINE, "variant 1": GOOD}
    for losses in ({"baseline": LOW, "variant 1": MIDDLE}, {"baseline": LOW, "variant 1": LOW}):
        assert best_by_reestimates([FIRST, studied("unlucky", scores, losses)], half=0).network[1] == "baseline"


def test_comparison_is_that_of_scipy_and_statsmodels() -> None:
    """Mann-Whitney U against the first search, and Holm over all the others."""
    near, far = ([value + 0.004 for value in sample] for sample in (GOOD, BETTER))
    others = [
        studied(name, {"baseline": BASELINE, "variant 1": values}, {"baseline": HIGH, "variant 1": MIDDLE})
        for name, values in (("near", near), ("far", far))
    ]
    chosen = best_by_reestimates([FIRST, *others], half=0)[1:]
    counted, against = [values[1::2] for values in (near, far)], GOOD[1::2]
    p_values = [stats.mannwhitneyu(values, against, method="exact").pvalue for values in counted]
    assert chosen.p_holm.tolist() == pytest.approx(list(multipletests(p_values, method="holm")[1]), rel=1e-6)
    wins = np.mean([[(own > other) + (own == other) / 2 for other in against] for own in counted[0]])
    assert chosen.a12[1] == pytest.approx(wins)


def test_renamed_run_has_the_same_interval() -> None:
    """The bootstrap's numbers follow from the run, not from where it lies."""
    chosen = [best_by_reestimates([FIRST, replace(SECOND, name=name)], half=1).loc[1] for name in ("a", "b")]
    assert chosen[0].drop("search").equals(chosen[1].drop("search"))


def test_table_says_what_one_search_each_cannot_show() -> None:
    """A share of images is in per cent, its difference in points, and the first search is compared with nothing."""
    table = searches_table([FIRST, SECOND])
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    assert [(row["chosen by"], row["search"]) for row in rows] == [
        *(("odd seeds", "grammar"), ("odd seeds", "model")),
        *(("even seeds", "grammar"), ("even seeds", "model")),
    ]
    assert rows[0]["p, Holm"] is None
    chosen, points = best_by_reestimates([FIRST, SECOND], half=0), rows[1]["difference of medians (percentage points)"]
    assert isinstance(points, Interval)
    assert (points.low, points.high) == pytest.approx((100 * chosen.difference_low[1], 100 * chosen.difference_high[1]))
    assert any(note.startswith("One search each") for note in table.notes)
    assert "70.5 % [63.5, 77.5]" in as_markdown(table)


def collected(search: StudiedSearch, *more: StudiedSearch, noise_run: Reestimates | None = None) -> Any:
    """Stand for a run with its studies, of which the first gives the re-estimates; perhaps with a noise run."""
    studies = [
        SimpleNamespace(name=f"study{number}", study=one.study, comparisons=())
        for number, one in enumerate((search, *more), start=1)
    ]
    run = SimpleNamespace(name=search.name, task=search.study.task)
    again = (search.reestimates, *([] if noise_run is None else [noise_run]))
    return SimpleNamespace(run=run, studies=studies, reestimates=again)


def elsewhere(search: StudiedSearch, *, epochs: int = 50) -> StudiedSearch:
    """Return a search with a study of the same networks on other data."""
    study = search.study
    data, recipe = replace(study.data, fingerprint="e" * 64), replace(study.recipe, epochs=epochs)
    return replace(search, study=replace(study, data=data, recipe=recipe, other_data=(("a", 1),)))


def test_runs_that_searched_alike_stand_in_one_table() -> None:
    """Another task would have a table of its own; of a run that is alone in its task nothing is said."""
    force = studied("force", {"baseline": HIGH}, {"baseline": HIGH}, Kind.regression)
    (table,), alone = side_by_side([collected(one) for one in (FIRST, SECOND, force)])
    assert (table.name, alone) == ("searches", [])


@pytest.mark.parametrize(
    "other",
    [
        replace(SECOND, study=replace(SECOND.study, run=FIRST.study.run)),
        replace(SECOND, reestimates=replace(SECOND.reestimates, epochs=6)),
        replace(SECOND, study=replace(SECOND.study, seeds=21)),
        replace(SECOND, study=replace(SECOND.study, recipe=replace(SECOND.study.recipe, epochs=90))),
        replace(SECOND, reestimates=replace(SECOND.reestimates, networks=FIRST.reestimates.networks)),
    ],
    ids=[
        "the same run",
        "other epochs of the search",
        "another number of seeds",
        "a longer study",
        "re-estimates of others",
    ],
)
def test_run_that_cannot_be_compared_is_named(other: StudiedSearch) -> None:
    """And what it would need; one that is there twice is one search."""
    tables, alone = side_by_side([collected(FIRST), collected(other)])
    assert tables == []
    assert alone[-1].startswith(
        "model is not beside the other runs of grating: expected another search of as many epochs"
    )


@pytest.mark.parametrize("few", ["study", "re-estimates"])
def test_three_seeds_are_too_few(few: str) -> None:
    """Each half chooses by two at least, and tests by two."""

    def lacking(search: StudiedSearch) -> StudiedSearch:
        if few == "study":
            return replace(search, study=replace(search.study, seeds=3))
        again = search.reestimates
        return replace(search, reestimates=replace(again, estimates=tuple(one[:3] for one in again.estimates)))

    assert side_by_side([collected(lacking(one)) for one in (FIRST, SECOND)])[0] == []


def test_studies_on_other_data_stand_in_a_table_of_their_own() -> None:
    """A search without such a study is beside the others once."""
    collections = [collected(one, elsewhere(one)) for one in (FIRST, SECOND)]
    (own, other), alone = side_by_side(collections)
    assert (own.name, other.name, alone) == ("searches", "searches_eeeeeeee", [])
    assert other.notes[0] == "Tested on other data than the runs': a=1."
    (only,), alone = side_by_side([collections[0], collected(SECOND)])
    assert (only.name, alone) == ("searches", [])


def test_re_estimates_of_the_study_on_the_runs_data_choose() -> None:
    """Also of networks that are tested on other data, and whatever a noise run of more networks or seeds says."""
    turned = replace(SECOND.reestimates, name="noise", estimates=SECOND.reestimates.estimates[::-1])
    collections = [collected(FIRST, elsewhere(FIRST)), collected(SECOND, elsewhere(SECOND), noise_run=turned)]
    for table in side_by_side(collections)[0]:
        rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
        assert [row["candidate"] for row in rows] == ["grammar1", "model2"] * 2
        lowest = rows[1]["re-estimated"]
        assert isinstance(lowest, Interval)
        assert lowest.estimate == pytest.approx(np.median(LOW[1::2]))


def test_a_noise_run_alone_chooses_nothing() -> None:
    """What a noise run re-estimates may be of other data than the other search's."""
    collections = [
        collected(one) for one in (FIRST, replace(SECOND, reestimates=replace(SECOND.reestimates, name="noise")))
    ]
    assert side_by_side(collections)[0] == []


def test_tables_of_one_name_are_numbered() -> None:
    """Two searches were tested after 50 epochs there, two others after 90."""
    third, fourth = (
        replace(one, name=name, study=replace(one.study, run=name)) for one, name in ((FIRST, "c"), (SECOND, "d"))
    )
    collections = [collected(one, elsewhere(one)) for one in (FIRST, SECOND)]
    collections += [collected(one, elsewhere(one, epochs=90)) for one in (third, fourth)]
    names = [table.name for table in side_by_side(collections)[0]]
    assert names == ["searches", "searches_eeeeeeee", "searches_eeeeeeee_2"]


def test_error_of_a_regression_is_in_its_own_unit() -> None:
    """And lower is better, which the note says."""
    searches = [
        studied(name, {"baseline": HIGH, "variant 1": errors}, {"baseline": HIGH, "variant 1": MIDDLE}, Kind.regression)
        for name, errors in (("first", MIDDLE), ("second", LOW))
    ]
    table = searches_table(searches)
    difference = dict(zip(table.columns, table.rows[1], strict=True))["difference of medians (MSE)"]
    assert isinstance(difference, Interval)
    assert difference.estimate == pytest.approx(-0.2)
    assert any("below 0.5 it is the better one" in note for note in table.notes)
