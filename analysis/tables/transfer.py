"""The table of transfer: the same networks on several data sets."""

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from analysis.statistics.tests import sign_p
from analysis.studies.comparison import Verdict, deciding_p, of_whole
from analysis.studies.metric_names import metric_name
from analysis.studies.transfer import OnData, OnSensors, concordance, joint, sensor_groups, tested_sensor, transfers
from analysis.table import Cell, Percent, PValue, Table
from analysis.tables.comparison import margin_in_words, score_cell
from tacevo.parts.output import Output
from tacevo.results.study import RecordedStudy
from tacevo.results.trivial import at_chance, trivial_score
from tacevo.rounding import rounded
from tacevo.text import assignments, counted

if TYPE_CHECKING:
    from analysis.report.collection import Collection, Compared

#: What the run's own data are called beside other data.
OWN = "the run's"


class Transfer(Output):
    """Adds what studies of the same networks on several data sets say together, to the first of them."""

    def study_tables(self, run: "Collection", study: "Compared") -> Sequence[Table]:
        """Make the tables of transfer, and those of sensors."""
        across = transfers((one.study, one.comparisons) for one in run.studies)
        sensors = sensor_groups((one.study for one in run.studies), run.run.config.data)
        return [
            *(table for one in across if one[0][0] is study.study for table in transfer_tables(one)),
            *(sensor_table(group) for group in sensors if group[0].study is study.study),
        ]


def transfer_tables(studies: Sequence[OnData]) -> list[Table]:
    """Return the table of transfer and, where there is a variant and seeds to test it with, the joint answer.

    The joint answer is of all data sets. To leave out those on which every network is at chance would be to choose by
    what the networks scored: those that stay are the ones where a network was lucky, and p would be too small.
    """
    first, _ = studies[0]
    is_tested = len(first.networks) > 1 and first.seeds > 1 and len(studies) > 1 and not _share_tests(studies)
    return [transfer_table(studies), *([joint_table(studies)] if is_tested else [])]


def sensor_table(group: Sequence[OnSensors]) -> Table:
    """Show the median of each network by the sensors that it was trained on, a row, and the tested one, a column."""
    first = group[0].study
    trained = sorted({one.trained for one in group}, key=lambda words: (" " in words or "+" in words, words))
    tested = sorted({one.tested for one in group})
    known = {(one.trained, one.tested): one.study for one in group}

    def score(network: str, words: str, sensor: str) -> Cell:
        study = known.get((words, sensor))
        if study is None:
            return None
        return score_cell(first.primary, rounded(float(np.median(study.values(network, first.primary)))))

    rows = [
        (network.name, words, *(score(network.name, words, sensor) for sensor in tested))
        for network in first.networks
        for words in trained
    ]
    has_within = any((sensor, sensor) in known for sensor in tested)
    lacks = any((words, sensor) not in known for words in trained for sensor in tested)
    single = [sensor for sensor in tested if "+" not in sensor and sensor != "*"]
    names = ",".join(single)
    return Table(
        name="transfer_sensors",
        caption=f"The networks of {first.task} by training sensor, a row, and test sensor, a column, median test "
        f"{metric_name(first.primary)}.",
        columns=("network", "trained on", *(f"tested on {sensor}" for sensor in tested)),
        rows=tuple(rows),
        notes=(
            f"Medians of {counted(first.seeds, 'training seed')} of {counted(first.recipe.epochs, 'epoch')}. Their "
            "comparisons with the baseline stand in the tables transfer and verdicts.",
            *(["Where a sensor is tested that trains, its training and its test images differ."] if has_within else []),
            *(
                [f"What is empty was not studied; data.sensor={names} data.test_sensor={names} studies each pair."]
                if lacks and len(single) > 1
                else []
            ),
        ),
    )


def _share_tests(studies: Sequence[OnData]) -> bool:
    """Return whether one sensor's test images are those of two data sets, as with several `data.shots`."""
    tested = [sensor for study, _ in studies if (sensor := tested_sensor(study)) is not None]
    return len(set(tested)) < len(tested)


def transfer_table(studies: Sequence[OnData]) -> Table:
    """Show each network on each data set: its median, and its verdict against the baseline there."""
    first, _ = studies[0]
    shared, is_grouped = _shared(studies), any(study.data.is_grouped for study, _ in studies)
    return Table(
        name="transfer",
        caption=f"The networks of {first.task} on {counted(len(studies), 'data set')}, test "
        f"{metric_name(first.primary)}.",
        columns=("data", "test images", *(["groups"] if is_grouped else []), "network", "median", "p, Holm", "verdict"),
        rows=tuple(row for one in studies for row in _rows(one, _where(one[0], shared), is_grouped=is_grouped)),
        notes=(
            f"On each data set every network was trained again, with the same {counted(first.seeds, 'training seed')} "
            f"and {counted(first.recipe.epochs, 'epoch')}.",
            *([f"Trained with other settings than the run: {first.trained_with}."] if first.other_device else []),
            *([f"All but the run's own have {', '.join(shared)}."] if shared else []),
            *_agreement(studies, shared),
            *_equivalence(studies, shared),
            "p and verdict: against the baseline on the same data, corrected after Holm over the variants of that data "
            "set, and not over data sets; "
            + (
                "some of these have the same test images, so there is no answer over all of them."
                if _share_tests(studies)
                else "the table transfer_joint has one answer over all of them."
            ),
        ),
    )


def _shared(studies: Sequence[OnData]) -> list[str]:
    """Return the settings in which all data sets but the run's own are alike; none where there is one."""
    moved = [assignments(study.other_data) for study, _ in studies if study.other_data]
    return [one for one in moved[0] if all(one in others for others in moved)] if len(moved) > 1 else []


def _where(study: RecordedStudy, shared: Sequence[str]) -> str:
    """Name the data of a study by the settings that it does not share with the others."""
    return ", ".join(one for one in assignments(study.other_data) if one not in shared) or study.where or OWN


def _agreement(studies: Sequence[OnData], shared: Sequence[str]) -> list[str]:
    """Say how far the data sets agree on the order of the networks, and which of them know none."""
    learnt = [one for one in studies if not at_chance(one[0])]
    chance = "; ".join(_where(study, shared) for study, _ in studies if at_chance(study))
    told = [f"Every network is at chance on {chance}. W, which describes an order, leaves that out."] if chance else []
    agreement = concordance(learnt) if len(learnt) > 1 else None
    if agreement is None:
        return told
    return [
        *told,
        f"The order of the networks by their medians agrees over the data sets with Kendall's W = {agreement:.2f}: 1 "
        "is one order everywhere, 0 is no agreement.",
    ]


def _equivalence(studies: Sequence[OnData], shared: Sequence[str]) -> list[str]:
    """Say of which test p is where a variant is equivalent, and by which margin."""
    margins = {}
    for study, comparisons in studies:
        for one in of_whole(comparisons).itertuples():
            if one.verdict == Verdict.equivalent:
                margins[_where(study, shared)] = margin_in_words(study, one.margin)
    if not margins:
        return []
    each = "; ".join(f"{margin} on {where}" for where, margin in margins.items())
    return [f"Where a variant is equivalent, p is that of the test of equivalence, whose margin is {each}."]


def joint_table(studies: Sequence[OnData]) -> Table:
    """Show what all data sets together say of each variant."""
    first, _ = studies[0]
    return Table.of(
        joint(studies),
        {
            "network": "network",
            **{f"data sets {word}": word for word in ("better", "equal", "worse")},
            "seeds ahead": (Percent, "ahead"),
            **{"p, these data": (PValue, "p_here"), "these data": "here"},
            **{"p, other data": (PValue, "p_elsewhere"), "other data": "elsewhere"},
        },
        name="transfer_joint",
        caption=f"The variants of {first.task} against the baseline over {counted(len(studies), 'data set')} together, "
        f"test {metric_name(first.primary)}.",
        notes=(
            "Data sets better, equal, worse: by the medians. Seeds ahead: pairs of a seed of the variant and one of "
            "the baseline on the same data, in which the variant is better; ties half.",
            "These data: whether seeds differ on these data sets, by Mann-Whitney's U summed over the data sets as "
            "blocks (van Elteren 1960; exact up to 33 seeds). It says nothing of other data.",
            "Other data: whether a data set drawn as these were would more often favour the variant, by the exact sign "
            f"test, in which each data set counts once. {_fewest(first)} Splits of one recording share most of their "
            "images, so p is then too small.",
            f"Both p are corrected after Holm over {counted(len(first.networks) - 1, 'variant')}, and the words are at "
            f"alpha {first.terms.alpha:g}.",
        ),
    )


def _fewest(study: RecordedStudy) -> str:
    """Say from how many data sets on the sign test can show anything of all variants."""
    level = study.terms.alpha / (len(study.networks) - 1)
    needed = next(number for number in itertools.count(1) if sign_p(number, 0) <= level)
    return f"After Holm's first step it can show something from {counted(needed, 'data set')} on."


def _rows(on: OnData, where: str, *, is_grouped: bool) -> Iterator[tuple[Cell, ...]]:
    study, comparisons = on
    head: tuple[Cell, ...] = (where, study.data.counts[2], *([study.data.units] if is_grouped else []))
    verdicts = {one.network: (PValue(deciding_p(one)), one.verdict) for one in of_whole(comparisons).itertuples()}
    for network in study.networks:
        median = rounded(float(np.median(study.values(network.name, study.primary))))
        yield *head, network.name, score_cell(study.primary, median), *verdicts.get(network.name, (None, None))
    if (score := trivial_score(study)) is not None:
        yield *head, "trivial", score_cell(study.primary, score), None, None
