"""Promise: studies that differ in their data only become one table of transfer, and one that stands alone says so."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hand_runs import closed, run, trained
from studies import around, study_of

from analysis.report.collection import Collection, Compared, tables_of, with_largest_studies
from analysis.runs.niches import Niches
from analysis.statistics.tests import blocked_mann_whitney, holm
from analysis.studies.comparison import compare
from analysis.studies.transfer import concordance, joint, sensor_groups, transfers
from analysis.sweeps.pilots import study_pilot
from analysis.sweeps.plans import Wish, plan
from analysis.table import Percent
from analysis.tables.comparison import ONE_SPLIT
from analysis.tables.transfer import OWN, joint_table, sensor_table, transfer_table, transfer_tables
from tacevo.records import Kind
from tacevo.results.study import RecordedStudy, is_alone

pytestmark = pytest.mark.room("plans, pilots")

NICHES = np.array([[0.3, 0.5], [0.7, 0.5]])

#: Two variants, of which the first is better than the baseline and the second worse; and the other way round.
ONE = {
    "baseline": around(0.02, step=0.0001),
    "a": around(0.01, step=0.0001),
    "b": around(0.04, step=0.0001),
}
OTHER = {"baseline": ONE["baseline"], "a": ONE["b"], "b": ONE["a"]}


def elsewhere(values: Mapping[str, Sequence[float]], split: int, **changes: Any) -> RecordedStudy:
    """Make a study on another split than the run's."""
    study = study_of(values)
    data = replace(study.data, fingerprint=f"{split:064d}")
    return replace(study, data=data, other_data=(("split_seed", split),), **changes)


def both() -> list[tuple[RecordedStudy, None]]:
    """Return the study of a run's data and one of another split, the other one first."""
    return [(elsewhere(OTHER, 7), None), (study_of(ONE), None)]


def collection(*studies: RecordedStudy) -> Collection:
    """Return a run with these studies."""
    compared = [
        Compared(name=f"study{number}", study=study, comparisons=compare(study))
        for number, study in enumerate(studies, start=1)
    ]
    searched = run([trained(0, 0, 0.5)], [closed(0, 0.5)], elites=[])
    niches = Niches(networks=NICHES, prompts=NICHES)
    return Collection(run=searched, niches=niches, studies=tuple(compared), reestimates=(), left_out=())


def test_table_is_network_by_data_set() -> None:
    """The run's own data come first; by hand, the variants change places on the other split."""
    studies = [study for study, _ in both()]
    (group,) = transfers((study, compare(study)) for study in studies)
    assert [(*row[:4], row[5]) for row in transfer_table(group).rows] == [
        (OWN, 1, "baseline", 0.02, None),
        (OWN, 1, "a", 0.01, "better"),
        (OWN, 1, "b", 0.04, "worse"),
        ("split_seed=7", 1, "baseline", 0.02, None),
        ("split_seed=7", 1, "a", 0.04, "worse"),
        ("split_seed=7", 1, "b", 0.01, "better"),
    ]


def test_groups_of_test_images_have_a_column_where_some_data_have_them() -> None:
    """Beside the images, of every data set."""
    (study, other) = (study for study, _ in both())
    grouped = replace(study, data=replace(study.data, counts=(8, 1, 6), groups=(0, 0, 0, 0, 1, 1)))
    (group,) = transfers([(grouped, None), (other, None)])
    table = transfer_table(group)
    assert table.columns[1:3] == ("test images", "groups")
    assert [row[1:3] for row in table.rows] == [(1, 1)] * 3 + [(6, 2)] * 3


def test_data_are_named_by_what_tells_them_apart() -> None:
    """What all others than the run's own share is said once, in a note; one that has nothing else is named whole."""
    left_out = (("sensor", "A+B"), ("test_sensor", "A")), (("sensor", "A+B"), ("test_sensor", "B"))
    moved = [replace(elsewhere(ONE, number), other_data=other) for number, other in enumerate(left_out)]
    table = transfer_table([(study, None) for study in (study_of(ONE), *moved)])
    assert list(dict.fromkeys(row[0] for row in table.rows)) == [OWN, "test_sensor=A", "test_sensor=B"]
    assert any("sensor=A+B." in note for note in table.notes)
    whole = replace(elsewhere(ONE, 3), other_data=(("sensor", "A+B"),))
    table = transfer_table([(study, None) for study in (whole, *moved)])
    assert list(dict.fromkeys(row[0] for row in table.rows)) == ["sensor=A+B", "test_sensor=A", "test_sensor=B"]


def on_sensors(number: int, **other: object) -> RecordedStudy:
    """Make a study with other sensors than the run's."""
    values = {name: around(0.01 * (number + place), step=0.0001) for place, name in enumerate(ONE)}
    return replace(elsewhere(values, number), other_data=tuple(other.items()))  # type: ignore[arg-type]


def test_sensors_are_one_matrix_whatever_the_protocol() -> None:
    """Rows are what was trained on, columns what was tested; the run's own sensor counts, and gaps are told."""
    own = replace(run([trained(0, 0, 0.5)], [closed(0, 0.5)], elites=[]).config.data, sensor="A")
    studies = [
        study_of(ONE),
        on_sensors(2, sensor="B"),
        on_sensors(3, sensor="B", test_sensor="A"),
        on_sensors(4, sensor="A+B", test_sensor="B"),  # which trains on A
        on_sensors(5, sensor="A+B+C", test_sensor="C"),
        on_sensors(6, sensor="A+B+C", test_sensor="B"),
        on_sensors(7, sensor="*", test_sensor="C", shots=5),
    ]
    apart = [elsewhere(ONE, 8), replace(on_sensors(9, sensor="B"), seeds=3)]
    (group,) = sensor_groups([*studies, *apart], own)
    table = sensor_table(group)
    assert table.columns == ("network", "trained on", "tested on A", "tested on B", "tested on C")
    assert table.rows[:5] == (
        ("baseline", "A", 0.02, 0.04, None),
        ("baseline", "B", 0.03, 0.02, None),
        ("baseline", "all others, 5 shots", None, None, 0.07),
        ("baseline", "the others of A+B+C", None, 0.06, 0.05),
        ("a", "A", 0.01, 0.05, None),
    )
    assert any("data.test_sensor=A,B,C" in note for note in table.notes)
    protocols = [[study.where for study, _ in group] for group in transfers((study, None) for study in studies)]
    assert [len(one) for one in protocols] == [2, 2]  # within; the others of three: neither across, nor all others
    names = [table.name for table in tables_of(collection(*studies), None)]
    assert names.count("study1/transfer_sensors") == 1


def test_sensors_within_themselves_are_no_matrix() -> None:
    """Simulated ones cannot be crossed: half of it would be empty, and no command could fill it."""
    own = replace(run([trained(0, 0, 0.5)], [closed(0, 0.5)], elites=[]).config.data, sensor="A")
    assert sensor_groups([study_of(ONE), on_sensors(2, sensor="B"), on_sensors(3, sensor="C")], own) == ()


def test_agreement_on_the_order_is_kendalls_w() -> None:
    """By hand: one order on all data sets is 1; ranks 2, 1, 3 and 2, 3, 1 add up to 4 each, which is 0."""
    same, again = study_of(ONE), elsewhere({name: [2 * value for value in ONE[name]] for name in ONE}, 7)
    assert concordance([(same, None), (again, None)]) == pytest.approx(1)
    assert concordance([(same, None), (again, None), (elsewhere(ONE, 8), None)]) == pytest.approx(1)
    assert concordance(both()) == pytest.approx(0)
    three = [(same, None), (elsewhere(ONE, 7), None), (elsewhere(OTHER, 8), None)]
    # Rank sums 6, 5 and 7 around 6: W = 12 * 2 / (3 ** 2 * (3 ** 3 - 3)).
    assert concordance(three) == pytest.approx(12 * 2 / (9 * 24))
    two = {name: ONE[name] for name in ("baseline", "a")}
    assert concordance([(study_of(two), None), (elsewhere(two, 7), None)]) is None
    flat = dict.fromkeys(ONE, [0.5] * 4)
    assert concordance([(study_of(flat), None), (elsewhere(flat, 7), None)]) is None


def test_joint_answer_keeps_seeds_and_data_sets_apart() -> None:
    """Six data sets that agree say something of others; five do not, and two that disagree say nothing, by hand."""
    agree = [elsewhere({name: ONE[name] for name in ("baseline", "a")}, split) for split in range(6)]
    group = joint([(study, None) for study in agree]).iloc[0]
    assert (group.better, group.equal, group.worse, group.ahead) == (6, 0, 0, 1)
    assert (group.here, group.elsewhere, group.p_elsewhere) == ("better", "better", 2 / 2**6)
    five = joint([(study, None) for study in agree[:5]]).iloc[0]
    assert (five.here, five.elsewhere) == ("better", "undecided")
    for row in joint([(study, None) for study, _ in both()]).itertuples():
        assert (row.better, row.worse, row.ahead, row.p_here, row.here) == (1, 1, 0.5, 1, "undecided")
    table = joint_table([(study, None) for study in agree])
    assert any("from 6 data sets on" in note for note in table.notes)
    three = joint([(study, None) for study in (study_of(ONE), elsewhere(ONE, 1), elsewhere(ONE, 2))])
    assert three.here.tolist() == ["better", "worse"]
    alone = [blocked_mann_whitney([(ONE[name], ONE["baseline"])] * 3).p for name in "ab"]
    assert tuple(three.p_here) == holm(alone)
    higher = [replace(study_of({"baseline": [0.5] * 4, "a": [0.6] * 4}, kind=Kind.classification))] * 2
    assert joint([(study, None) for study in higher]).better.tolist() == [2]


def confused(values: Mapping[str, Sequence[float]], split: int) -> RecordedStudy:
    """Make a study of two classes, alike frequent, on another split; accuracies are multiples of 0.01."""
    study = study_of(values, kind=Kind.classification)
    tables = [
        ((round(100 * score.metrics["accuracy"]), 100 - round(100 * score.metrics["accuracy"])), (0, 100))
        for score in study.scores
    ]
    told = tuple(replace(score, confusion=table) for score, table in zip(study.scores, tables, strict=True))
    return replace(
        study, scores=told, data=replace(study.data, fingerprint=f"{split:064d}"), other_data=(("split_seed", split),)
    )


def test_data_set_at_chance_has_no_part_in_an_order() -> None:
    """There a network is first by luck. The tests keep the data set: to choose by scores would spoil them."""
    learnt = {"baseline": [0.7, 0.71, 0.72, 0.73], "a": [0.8, 0.81, 0.82, 0.83], "b": [0.9, 0.91, 0.92, 0.93]}
    luck = {"baseline": [0.5, 0.51, 0.5, 0.51], "a": [0.5] * 4, "b": [0.49] * 4}
    one, again, lost = confused(learnt, 1), confused(learnt, 2), confused(luck, 3)
    table, answer = transfer_tables([(study, None) for study in (one, again, lost)])
    assert any("at chance on split_seed=3." in note for note in table.notes)
    assert any("Kendall's W = 1.00" in note for note in table.notes)
    assert answer.rows == joint_table([(one, None), (again, None), (lost, None)]).rows
    alone, _ = transfer_tables([(one, None), (lost, None)])
    assert not any("Kendall" in note for note in alone.notes)
    assert all("at chance" not in note for note in transfer_table([(one, None), (again, None)]).notes)


def test_protocols_that_share_test_images_are_not_joined() -> None:
    """Crossing sensors, leaving one out and a few shots test one sensor's images again and again."""

    def of(number: int, **settings: str | int) -> tuple[RecordedStudy, None]:
        study = study_of(ONE)
        other = tuple(settings.items())
        return replace(study, data=replace(study.data, fingerprint=f"{number:064d}"), other_data=other), None

    cross = [of(1, sensor="A", test_sensor="B"), of(2, sensor="A", test_sensor="C")]
    left_out = [of(3, sensor="A+B+C", test_sensor="B"), of(4, sensor="A+B+C", test_sensor="C")]
    own = [(study_of(ONE), None), of(5, sensor="B")]
    groups = transfers([*own, *cross, *left_out])
    assert sorted(len(group) for group in groups) == [2, 2, 2]
    assert [len(transfer_tables(group)) for group in groups] == [2, 2, 2]
    shots = [of(6 + shots, sensor="A+B+C", test_sensor="C", shots=shots) for shots in (1, 10, 5)]
    (group,) = transfers(shots)
    assert [dict(study.other_data)["shots"] for study, _ in group] == [1, 5, 10]
    assert [table.name for table in transfer_tables(group)] == ["transfer"]


def test_shares_are_percentages() -> None:
    """And without a comparison, there are the medians."""
    own = study_of({"baseline": [0.5] * 4, "a": [0.5] * 4, "b": [0.75] * 4}, kind=Kind.classification)
    moved = replace(own, data=replace(own.data, fingerprint="e" * 64), other_data=(("light", "dim"),))
    (group,) = transfers([(own, None), (moved, None)])
    assert transfer_table(group).rows[2][3:] == (Percent(0.75), None, None)


def test_studies_that_differ_otherwise_are_not_set_beside_each_other() -> None:
    """Other networks, seeds or epochs: a difference could be theirs."""
    own = study_of(ONE)
    fewer = {name: values for name, values in OTHER.items() if name != "b"}
    longer = replace(own.recipe, epochs=own.recipe.epochs + 1)
    for other in (elsewhere(fewer, 7), elsewhere(OTHER, 7, recipe=longer), elsewhere(OTHER, 7, chosen_by="0" * 64)):
        assert transfers([(own, None), (other, None)]) == ()


def test_warning_of_one_split_goes_with_a_second_one() -> None:
    """It stands in scores and verdicts of each study whose networks have one data set only."""
    warned = {table.name for table in tables_of(collection(study_of(ONE)), None) if ONE_SPLIT in table.notes}
    assert warned == {"study1/scores", "study1/verdicts"}
    tables = tables_of(collection(study_of(ONE), elsewhere(OTHER, 7)), None)
    assert not [table.name for table in tables if ONE_SPLIT in table.notes]
    assert {"study1/transfer", "study1/transfer_joint"} <= {table.name for table in tables}


def test_paper_takes_the_largest_study_on_each_data_set() -> None:
    """That on the run's own data first, however large one on other data is."""
    large = elsewhere(OTHER, 7, recipe=replace(study_of(ONE).recipe, epochs=500))
    kept = with_largest_studies(collection(elsewhere(OTHER, 7), large, study_of(ONE)))
    assert [compared.name for compared in kept.studies] == ["study3", "study2"]
    assert [compared.name for compared in kept.passed_over] == ["study1"]


def test_paper_warns_of_one_split_only_where_there_is_one() -> None:
    """A study on other data that a longer one there displaces is not shown, but it is there."""
    longer = elsewhere(OTHER, 7, recipe=replace(study_of(ONE).recipe, epochs=500))
    for studies, warned in (([study_of(ONE)], True), ([study_of(ONE), elsewhere(OTHER, 7), longer], False)):
        tables = tables_of(with_largest_studies(collection(*studies)), None)
        assert not any(table.name.startswith("transfer") for table in tables)
        assert any(ONE_SPLIT in table.notes for table in tables if table.name == "study1/scores") is warned


def test_study_that_follows_a_plan_is_compared_with_one_elsewhere() -> None:
    """A plan changes no score; with and without it, a study of one data set stands in the table once."""
    pilot = study_pilot([(run([trained(0, 0)], []), study_of(ONE))])
    written = plan(pilot, Wish(effect=0.1, alpha=0.05, power=0.8, comparisons=2)).plan
    planned, other = replace(study_of(ONE), plan=written), elsewhere(OTHER, 7)
    (group,) = transfers([(planned, None), (study_of(ONE), None), (other, None)])
    assert [study.where for study, _ in group] == ["", "split_seed=7"]
    assert not is_alone(planned, [other])
    assert is_alone(planned, [study_of(ONE)])
    assert not transfers([(planned, None), (study_of(ONE), None)])
