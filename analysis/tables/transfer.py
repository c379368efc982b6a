"""The table of transfer: the same networks on several data sets."""

from collections.abc import Iterator, Sequence

import numpy as np

from analysis.studies.comparison import of_whole
from analysis.studies.metric_names import metric_name
from analysis.studies.transfer import OnData, concordance
from analysis.table import Cell, PValue, Table
from analysis.tables.comparison import score_cell
from tacevo.results.trivial import trivial_score
from tacevo.rounding import rounded
from tacevo.text import counted

#: What the run's own data are called beside other data.
OWN = "the run's"


def transfer_table(studies: Sequence[OnData]) -> Table:
    """Show each network on each data set: its median, and its verdict against the baseline there."""
    first, _ = studies[0]
    return Table(
        name="transfer",
        caption=f"The networks of {first.task} on {counted(len(studies), 'data set')}, test "
        f"{metric_name(first.primary)}.",
        columns=("data", "test images", "network", "median", "p, Holm", "verdict"),
        rows=tuple(row for one in studies for row in _rows(one)),
        notes=(
            f"On each data set every network was trained again, with the same {counted(first.seeds, 'training seed')} "
            f"and {counted(first.recipe.epochs, 'epoch')}.",
            *_agreement(studies),
            "p and verdict: against the baseline on the same data, corrected after Holm over the variants of that data "
            "set, and not over data sets. Splits of one recording share most of their images, so they are not "
            "independent.",
        ),
    )


def _agreement(studies: Sequence[OnData]) -> list[str]:
    """Say how far the data sets agree on the order of the networks."""
    found = concordance(studies)
    if found is None:
        return []
    return [
        f"The order of the networks by their medians agrees over the data sets with Kendall's W = {found:.2f}: 1 is "
        "one order everywhere, 0 is no agreement."
    ]


def _rows(on: OnData) -> Iterator[tuple[Cell, ...]]:
    study, found = on
    head = study.where or OWN, study.data.counts[2]
    verdicts = {one.network: (PValue(one.p_holm), one.verdict) for one in of_whole(found).itertuples()}
    for network in study.networks:
        median = rounded(float(np.median(study.values(network.name, study.primary))))
        yield *head, network.name, score_cell(study.primary, median), *verdicts.get(network.name, (None, None))
    if (score := trivial_score(study)) is not None:
        yield *head, "trivial", score_cell(study.primary, score), None, None
