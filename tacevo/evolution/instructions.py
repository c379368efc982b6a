"""The draws of a mutation's instruction: the paper's, and those of controls; pure (`tacevo.parts.Prompts`)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tacevo.evolution.prompts import UNPRODUCTIVE, draw_weighted
from tacevo.parts import PromptHistory, Prompts
from tacevo.rounding import rounded

#: The policy `effect`: children that its prior belief in no effect weighs as much as, how far the weights follow an
#: effect, and their ends, so that every instruction stays within reach. Our own, as the policy is.
_PRIOR, _STRENGTH, _LEAST, _MOST = 5, 4.0, 0.1, 10.0


@dataclass(frozen=True)
class Uniform(Prompts):
    """All of the pool alike (the paper's method section)."""

    def draw(self, history: PromptHistory, pool: Sequence[int], rng: np.random.Generator) -> int:
        """Draw an instruction."""
        return pool[int(rng.integers(len(pool)))]


@dataclass(frozen=True)
class Unrecorded(Uniform):
    """All of the pool alike, and no prompt archive."""

    records = False


@dataclass(frozen=True)
class Curious(Uniform):
    """Draws from the archive's trials of pooled instructions, in proportion to their curiosity (the paper's abstract).

    An instruction without a trial there weighs as much as an unproductive one, so that each stays within reach. While
    there is no trial, all weigh alike, so that arms of an ablation begin alike.
    """

    def draw(self, history: PromptHistory, pool: Sequence[int], rng: np.random.Generator) -> int:
        """Draw an instruction."""
        trials = [trial for trial in history.trials if trial.prompt in pool]
        if not trials:
            return super().draw(history, pool, rng)
        untried = sorted(set(pool) - {trial.prompt for trial in trials})
        choices = [(trial.prompt, trial.curiosity) for trial in trials]
        choices += [(prompt, UNPRODUCTIVE) for prompt in untried]
        return choices[draw_weighted([weight for _, weight in choices], rng)][0]


@dataclass(frozen=True)
class Effect(Uniform):
    """Draws by each instruction's effect on its children's loss so far (`effect_weights`); alike without children."""

    def draw(self, history: PromptHistory, pool: Sequence[int], rng: np.random.Generator) -> int:
        """Draw an instruction."""
        if not history.changes:
            return super().draw(history, pool, rng)
        return pool[draw_weighted(effect_weights(history.changes, pool), rng)]


def effect_weights(changes: Mapping[int, tuple[int, float]], pool: Sequence[int]) -> list[float]:
    """Weigh instructions by what they did to the loss of their children, shrunken towards the mean of all.

    The effect of an instruction is the mean change of a logarithm of its n children less that of all children, times
    n / (n + 5); its weight is exp(-4 effect), from 0.1 to 10. So one without a child weighs 1.

    Args:
        changes: children and sum of changes of each instruction that has some, by index.
        pool: the instructions to be weighed.
    """
    mean = math.fsum(total for _, total in changes.values()) / sum(count for count, _ in changes.values())
    weights = []
    for prompt in pool:
        count, total = changes.get(prompt, (0, 0.0))
        effect = (total - count * mean) / (count + _PRIOR)
        weights.append(rounded(min(max(math.exp(-_STRENGTH * effect), _LEAST), _MOST)))
    return weights
