"""A model of the genes of a table's networks, which says whom a judge trains with fresh seeds.

It is a regression by least squares of a network's mean log test loss over the recorded seeds on a constant, each gene
and each pair of genes; every value of a gene but its first is an indicator, and every product of two of them is one. So
a network's luck under its own few seeds hardly decides whether it is judged: what counts is what its genes have in
common with others.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tacevo.results.judged_loss import mean_log_loss
from tacevo.results.table_records import SpaceTable

#: Decimals of an expected log loss: other libraries of linear algebra give other last bits.
_DECIMALS = 9


def put_first(table: SpaceTable, count: int) -> tuple[int, ...]:
    """Return the rows of the networks that the model expects the lowest losses of, the lowest first.

    The model has nothing to say of the baseline's file, which has no genome, nor of networks that the gate refused or
    that failed with a seed: they are left out. Of networks with equal expectations (to nine decimals) the one with the
    lower row comes first. A network with a test loss of 0, whose mean would be minus infinity, counts as the lowest
    mean of the others.

    Args:
        table: of the networks.
        count: how many; fewer where the table has fewer.
    """
    rows = [row for row in table.test_losses if table.networks[row].genome is not None]
    if not rows:
        return ()
    design = _indicators([table.networks[row].genome or {} for row in rows])
    means = np.array([mean_log_loss(table.test_losses[row]) for row in rows])
    finite = means[np.isfinite(means)]
    means = np.maximum(means, finite.min() if finite.size else 0.0)
    expected = (design @ np.linalg.lstsq(design, means, rcond=None)[0]).round(_DECIMALS).tolist()
    return tuple(row for _, row in sorted(zip(expected, rows, strict=True))[:count])


def _indicators(genomes: Sequence[dict[str, bool | int | float | str]]) -> NDArray[np.float64]:
    """Return the model's columns for each genome, shape (n, columns)."""
    groups = []
    for gene in genomes[0]:
        _, *others = sorted({genome[gene] for genome in genomes}, key=str)
        groups.append([[float(genome[gene] == value) for genome in genomes] for value in others])
    columns = [[1.0] * len(genomes), *(column for group in groups for column in group)]
    columns += [
        [a * b for a, b in zip(one, other, strict=True)]
        for first, second in combinations(groups, 2)
        for one in first
        for other in second
    ]
    return np.array(columns).T
