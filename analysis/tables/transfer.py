"""The tables of transfer: the same networks on several data sets."""

from collections import Counter
from statistics import fmean

from analysis.rounding import shown
from analysis.studies.comparison import Verdict
from analysis.studies.metrics import SHARES, metric_name
from analysis.studies.transfer import OnData, Result, Transfer
from analysis.table import Cell, Percent, PValue, Table
from tacevo.results.trivial import trivial_score
from tacevo.rounding import rounded
from tacevo.text import counted


def transfer_tables(found: Transfer) -> tuple[Table, ...]:
    """Return all tables of a transfer; without variants there is nothing to count."""
    return (transfer_table(found), counts_table(found)) if len(found.data[0].results) > 1 else (transfer_table(found),)


def transfer_table(found: Transfer) -> Table:
    """Show each network on each data set: its median, its rank, and its verdict against the baseline there."""
    first = found.data[0].study
    is_share = first.primary in SHARES
    return Table(
        name=f"transfer_{first.task}",
        caption=f"The networks of {first.task} on {counted(len(found.data), 'data set')}, test "
        f"{metric_name(first.primary)}.",
        columns=("data", "test images", "network", "median", "rank", "p, Holm", "verdict"),
        rows=tuple(
            (
                *(on.where, on.study.data.counts[2], name),
                *(Percent(one.median) if is_share else one.median, one.rank),
                None if one.p_holm is None else PValue(one.p_holm),
                None if one.verdict is None else one.verdict.value,
            )
            for on in found.data
            for name, one in (*on.results.items(), *_trivial(on))
        ),
        notes=(
            f"On each data set every network was trained again, with the same {counted(first.seeds, 'training seed')} "
            f"and {counted(first.recipe.epochs, 'epoch')}. Rank: by the median, 1 is best; equal medians share one.",
            "p and verdict: against the baseline on the same data, corrected after Holm over the variants of that data "
            "set, and not over data sets. Splits of one recording share most of their images, so they are not "
            "independent.",
            *_agreement_note(found),
        ),
    )


def _trivial(on: OnData) -> tuple[tuple[str, Result], ...]:
    """Return what looks at no image, below the networks; without a rank among them."""
    score = trivial_score(on.study)
    return () if score is None else (("trivial", Result(median=score, rank=None, p_holm=None, verdict=None)),)


def counts_table(found: Transfer) -> Table:
    """Show each network's ranks over the data sets, and how often each verdict was given to it."""
    first = found.data[0]
    return Table(
        name=f"transfer_counts_{first.study.task}",
        caption=f"The networks of {first.study.task} over {counted(len(found.data), 'data set')}.",
        columns=("network", "mean rank", "best rank", "worst rank", *(verdict.value for verdict in Verdict)),
        rows=tuple(_counts(found, name) for name in first.results),
        notes=(
            "Verdicts: on how many data sets each was given. No test says of a network that it is better on data sets "
            "in general; that takes independent ones.",
        ),
    )


def _counts(found: Transfer, name: str) -> tuple[Cell, ...]:
    ranks = [rank for on in found.data if (rank := on.results[name].rank) is not None]
    given = Counter(on.results[name].verdict for on in found.data)
    verdicts = (given[verdict] for verdict in Verdict) if given.keys() != {None} else (None for _ in Verdict)
    return name, rounded(fmean(ranks)), min(ranks), max(ranks), *verdicts


def _agreement_note(found: Transfer) -> tuple[str, ...]:
    pairs = [f"{on.where} {shown(on.agreement)}" for on in found.data if on.agreement is not None]
    if not pairs:
        return ()
    return (f"Kendall's tau of the medians with those on {found.data[0].where} data: {'; '.join(pairs)}.",)
