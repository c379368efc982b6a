"""Prompts: which instruction a mutation has."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacevo.parts import PromptHistory, Prompts


@dataclass(frozen=True)
class Mine(Prompts):
    """One of the instructions that were tried least."""

    def draw(self, history: PromptHistory, pool: Sequence[int], rng: np.random.Generator) -> int:
        """Draw one of the pool."""
        tried = {index: history.changes.get(index, (0, 0.0))[0] for index in pool}
        least = [index for index in pool if tried[index] == min(tried.values())]
        return least[rng.integers(len(least))]
