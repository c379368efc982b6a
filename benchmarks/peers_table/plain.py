"""Two searches that need no library: random draws, and regularised evolution."""

from collections import deque
from collections.abc import Generator

from benchmarks.peers_table.asking import Choices, Genes
from tacevo.randomness import stream

#: Networks that live, and how many of them compete to be the next parent, as NAS-Bench-201 runs it.
POPULATION, COMPETE = 10, 3


def draws(choices: Choices, seed: int, trainings: int) -> Generator[Genes, float, None]:
    """Draw each gene."""
    rng = stream(seed, "peers_table", "draws")
    while True:
        yield {name: values[int(rng.integers(len(values)))] for name, values in choices.items()}


def regularised_evolution(choices: Choices, seed: int, trainings: int) -> Generator[Genes, float, None]:
    """Give one gene of the best of a few another value; the oldest dies (Real et al. 2019, arXiv:1802.01548)."""
    rng = stream(seed, "peers_table", "evolution")
    living: deque[tuple[float, Genes]] = deque(maxlen=POPULATION)
    for genes in draws(choices, seed, trainings):
        living.append(((yield genes), genes))
        if len(living) == POPULATION:
            break
    changeable = [name for name, values in choices.items() if len(values) > 1]
    while True:
        rivals = [living[place] for place in rng.choice(POPULATION, size=COMPETE, replace=False)]
        _, parent = min(rivals, key=lambda one: one[0])
        name = changeable[int(rng.integers(len(changeable)))]
        others = [value for value in choices[name] if value != parent[name]]
        child = {**parent, name: others[int(rng.integers(len(others)))]}
        living.append(((yield child), child))
