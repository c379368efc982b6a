"""The figures of an archive after its elites were trained again: what of it is found, and what is luck.

An archive of recorded fitnesses is illusory: each niche holds the luckiest of its candidates. The corrected archive is
filled again by re-estimates (Flageat and Cully 2023, arXiv:2302.00463). Descriptors follow from the source
and carry no noise here, so every elite comes back to its niche, and coverage falls only where a training fails.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from analysis.studies.reestimates import Reestimates
from tacevo.evolution.archive import Archive, Elite, coverage, insert, qd_score
from tacevo.evolution.run_files import EliteEntry
from tacevo.rounding import rounded

#: The columns of an archive's figures, and the type of each, a row `recorded` (illusory) and a row `reestimated`: the
#: sum of 1 / (1 + f) over its elites; the occupied part of its niches, in [0, 1]; the lowest loss and whose it is,
#: missing of an empty archive; ids of the elites that were not trained with every seed, whose niches are empty.
CORRECTED = {"qd_score": "float64", "coverage": "float64", "best": "float64", "best_id": "str", "lost": "object"}


def correct(
    elites: Sequence[EliteEntry], places: int, sources: Mapping[str, str | None], again: Reestimates
) -> pd.DataFrame | None:
    """Fill an archive again by the medians of re-estimates (`CORRECTED`).

    Args:
        elites: of the archive, each with its niche and its recorded fitness.
        places: how many niches the archive has.
        sources: SHA-256 of each candidate's source, by id; equal sources are one network.
        again: the re-estimates.

    Returns:
        None where an elite was not trained again: what is left would be another archive.
    """
    medians = dict(zip((network.source for network in again.networks), again.medians, strict=True))
    failed = {network.source for network in again.failed}
    if any(sources[elite.id] not in medians.keys() | failed for elite in elites):
        return None
    losses = {elite.id: medians.get(str(sources[elite.id])) for elite in elites}
    rows = {
        "recorded": _figures({elite.id: elite.fitness for elite in elites}, elites, places),
        "reestimated": _figures(losses, elites, places),
    }
    return pd.DataFrame.from_dict(rows, orient="index", columns=list(CORRECTED)).astype(CORRECTED)


def _figures(losses: Mapping[str, float | None], elites: Sequence[EliteEntry], places: int) -> tuple[Any, ...]:
    archive = Archive()
    for elite in elites:
        loss = losses[elite.id]
        if loss is not None:
            archive, _ = insert(archive, elite.niche, Elite(name=elite.id, objective=-loss))
    best = max(archive.elites.values(), key=lambda elite: elite.objective, default=None)
    return (
        rounded(qd_score(archive)),
        rounded(coverage(archive, places)),
        *((None, None) if best is None else (-best.objective, best.name)),
        tuple(name for name, loss in losses.items() if loss is None),
    )
