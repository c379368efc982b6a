"""The choice of the model that a slot asks, where a search has several: by fixed weights, or by a bandit; pure.

The bandit is UCB1 (Auer, Cesa-Bianchi and Fischer 2002) on the gain of each child, as ShinkaEvolve (2025) has it.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from tacevo.choices import ModelChoice
from tacevo.evolution.prompts import draw_weighted
from tacevo.randomness import stream
from tacevo.rounding import rounded


@dataclass(frozen=True, slots=True, kw_only=True)
class Gains:
    """What came of the answers of one model: how many there were, and the sum of their gains."""

    answers: int = 0
    total: float = 0.0

    def adding(self, gain: float) -> "Gains":
        """Return it with one more answer."""
        return replace(self, answers=self.answers + 1, total=self.total + gain)


def gain_of(fitness: float | None, parents: Iterable[float]) -> float:
    """Return the gain of a child in [0, 1]: the logarithm by which its loss is below that of its better parent.

    It is 0 of a child that is not better or did not train (None), and 1 where the loss is e times lower or more.

    Args:
        fitness: the child's; None where it did not train.
        parents: those of its parents, >= 0, at least one.
    """
    best = min(parents)
    if fitness is None or fitness >= best:
        return 0.0
    return 1.0 if fitness <= 0 else min(1.0, rounded(math.log(best / fitness)))


def draw_models(
    models: tuple[tuple[str, float], ...],
    choice: ModelChoice,
    gains: Mapping[str, Gains],
    *,
    seed: int,
    generation: int,
    slots: Iterable[int],
) -> list[str]:
    """Return the model of each slot of a generation.

    By `weights` a slot draws from a stream of its own. The `bandit` draws nothing: slot after slot it takes the model
    with the largest m + sqrt(2 ln N / n), where n are the answers of a model, m is their mean gain, and N are the
    answers of all; slots of this generation before it count as answers of the mean gain. A model without an answer
    comes first, and of several alike the first one in the user's order.

    Args:
        models: names and weights > 0, in the user's order.
        choice: how they are chosen.
        gains: what came of earlier generations, by name.
        seed: of the search.
        generation: the number of the generation.
        slots: the numbers of its slots.
    """
    if choice is ModelChoice.weights:
        weights = [weight for _, weight in models]
        return [models[draw_weighted(weights, stream(seed, "model", generation, slot))][0] for slot in slots]
    known = {name: gains.get(name, Gains()) for name, _ in models}
    chosen = []
    for _ in slots:
        answers = sum(one.answers for one in known.values())
        name = max(known, key=lambda name: _bound(known[name], answers))  # the first one of several alike
        mean = known[name].total / known[name].answers if known[name].answers else 0.0
        known[name] = known[name].adding(mean)
        chosen.append(name)
    return chosen


def _bound(gains: Gains, answers: int) -> float:
    """Return the upper confidence bound of a model's mean gain, of so many answers of all models."""
    if gains.answers == 0:
        return math.inf
    return rounded(gains.total / gains.answers + math.sqrt(2 * rounded(math.log(answers)) / gains.answers))
