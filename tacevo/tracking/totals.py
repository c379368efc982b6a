"""How far a search has come, in the few figures by which searches are compared: pure."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

from tacevo.costs import Spending, total
from tacevo.records import Json
from tacevo.tracking.entries import Measure, cost_measures


@dataclass(frozen=True, slots=True, kw_only=True)
class Totals:
    """What the generations so far come to."""

    #: Best fitness of the first generation in which anything was trained.
    first: float | None = None
    #: Trained candidates, with those after a repair.
    trained: int = 0
    #: Part of the slots whose first answer was trained, in [0, 1], for each generation from 1 on.
    trainable: tuple[float, ...] = ()
    spent: Spending = field(default_factory=Spending)

    def after(self, line: Mapping[str, Json], spent: Spending) -> Self:
        """Give the totals after one generation more.

        Args:
            line: its ledger line.
            spent: what its answers cost.
        """
        shares = (line["trained"] / line["candidates"],) if line["generation"] and line["candidates"] else ()
        return type(self)(
            first=line["best"] if self.first is None else self.first,
            trained=self.trained + line["trained"] + line.get("repaired", 0),
            trainable=(*self.trainable, *shares),
            spent=total((self.spent, spent)),
        )


def total_measures(totals: Totals, line: Mapping[str, Json]) -> tuple[Measure, ...]:
    """Give the metrics of what adds up over a search.

    Args:
        totals: after the generation.
        line: the generation's ledger line.

    Returns:
        `improvement` on the first best, a part of it in (-inf, 1]; `trainable_rate`, the mean over generations 1 to
        this one, in [0, 1]; `trained_candidates`; and the costs so far as `total_answers` and so on. What does not
        apply yet is left out.
    """
    step = line["generation"]
    figures = {"trained_candidates": float(totals.trained)}
    if totals.first is not None:
        figures["improvement"] = (totals.first - line["best"]) / totals.first if totals.first else 0.0
    if totals.trainable:
        figures["trainable_rate"] = sum(totals.trainable) / len(totals.trainable)
    costs = {f"total_{measure.key}": measure.value for measure in cost_measures(totals.spent, step)}
    return tuple(Measure(key=key, value=value, step=step) for key, value in {**figures, **costs}.items())
