"""The table of searches beside each other."""

from collections.abc import Sequence

from analysis.statistics.effects import LEVEL
from analysis.studies.metrics import SHARES, metric_name
from analysis.studies.searches import HandedOver
from analysis.table import Between, Cell, PercentBetween, PValue, Table
from analysis.tables.comparison import between, unit_of
from tacevo.text import counted


def searches_table(found: Sequence[HandedOver]) -> Table:
    """Show what each search of a task hands over, and how far it differs from what the first one does."""
    first = found[0].search
    study, again = first.study, first.again
    return Table(
        name=f"searches_{study.task}",
        caption=f"What the searches of {study.task} hand over, by test {metric_name(study.primary)}; each against that "
        f"of {first.name}.",
        columns=(
            *("search", "candidate", "recorded fitness", "re-estimated", "parameters", "FLOPs"),
            f"test {metric_name(study.primary)}",
            *(f"difference of medians ({unit_of(study.primary)})", "A12", "p, Holm"),
        ),
        rows=tuple(_cells(one, study.primary) for one in found),
        notes=(
            "Each search hands over the studied network with the lowest re-estimated fitness, the median of "
            f"{counted(study.seeds, 'seed')} after {counted(again.epochs, 'epoch')}; no test score has a part in that. "
            f"Tested: after {counted(study.recipe.epochs, 'epoch')} (weights of the best validation epoch), on "
            f"{counted(study.data.counts[2], 'image')}. In brackets {100 * LEVEL:g} % intervals.",
            "One search each: intervals and p hold for the training seeds of these networks. They do not say what "
            "another search of either kind finds, nor what other images show.",
        ),
    )


def _cells(one: HandedOver, metric: str) -> tuple[Cell, ...]:
    shape = PercentBetween if metric in SHARES else Between
    network, tested = one.network, one.tested
    compared: tuple[Cell, ...] = (None, None, None)
    if one.effects is not None and one.p_holm is not None:
        factor = 100 if metric in SHARES else 1
        compared = (
            between(one.effects.median_difference, factor),
            between(one.effects.a12),
            PValue(one.p_holm),
        )
    return (
        *(one.search.name, network.id, network.fitness, one.reestimated, network.parameters, network.flops),
        shape(tested.estimate, tested.low, tested.high),
        *compared,
    )
