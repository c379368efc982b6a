"""Nevergrad: a dictionary of choices, and the discrete optimiser that mixes several rates of mutation."""

from collections.abc import Generator

import nevergrad

from benchmarks.peers_table.asking import Choices, Genes


def one_plus_one(choices: Choices, seed: int, trainings: int) -> Generator[Genes, float, None]:
    """Search by `PortfolioDiscreteOnePlusOne`."""
    space = nevergrad.p.Dict(**{name: nevergrad.p.Choice(list(values)) for name, values in choices.items()})
    space.random_state.seed(seed)
    optimiser = nevergrad.optimizers.PortfolioDiscreteOnePlusOne(space, budget=trainings)
    while True:
        asked = optimiser.ask()
        optimiser.tell(asked, (yield asked.value))
