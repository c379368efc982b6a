"""Searches of one task beside each other, each by the studied network that its re-estimates choose.

Neither a test score nor a recorded fitness, which is one draw, has a part in that choice. One half of the seeds
chooses, and the other half re-estimates and tests what was chosen, so that luck which chooses a network does not count
for it. Where the halves, each in its turn, choose different networks, the choice itself is a draw.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from analysis.statistics.effects import EFFECTS, effects, median, superiority
from analysis.statistics.tests import holm, mann_whitney
from analysis.studies.reestimates import Reestimates
from tacevo.randomness import stream
from tacevo.results.study import RecordedStudy

#: The fewest seeds of a study: each half has two.
LEAST_SEEDS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class StudiedSearch:
    """A search with its study."""

    #: The name of the run.
    name: str
    study: RecordedStudy
    #: The re-estimates of the study's networks, on the run's data.
    reestimates: Reestimates


#: The columns of the networks that re-estimates choose, and the type of each, a search a row: its name; the network,
#: its id and its recorded fitness; the median of its losses after as many epochs as the search had, and of its test
#: scores. Missing of the first search, which the others are compared with: the chance that a re-estimate is lower, the
#: effects of the test scores, and p of their Mann-Whitney U after Holm's correction over all searches but the first.
CHOSEN = (
    dict.fromkeys(("search", "network", "candidate"), "str")
    | {"fitness": "float64"}
    | {f"{name}{end}": "float64" for name in ("reestimated", "tested", "lower_loss") for end in ("", "_low", "_high")}
    | dict.fromkeys((*EFFECTS, "p_holm"), "float64")
)


def best_by_reestimates(searches: Sequence[StudiedSearch], *, half: int) -> pd.DataFrame:
    """Return the network that is chosen of each search, compared with that of the first (`CHOSEN`).

    Args:
        searches: two or more different ones of one task, of equal epochs; their studies have one data set, recipe
            and number of seeds, `LEAST_SEEDS` or more.
        half: of the seeds, which chooses: 0 for the first, third ..., or 1 for those between them.
    """
    rows: list[dict[str, Any]] = []
    losses, scores = [], []
    for search in searches:
        again = search.reestimates
        best = int(np.argmin([np.median(estimates[half::2]) for estimates in again.estimates]))
        network = again.networks[best]
        losses.append(np.array(again.estimates[best][1 - half :: 2]))
        scores.append(search.study.values(network.name, search.study.primary)[1 - half :: 2])
        row = {"search": search.name, "network": network.name, "candidate": network.id, "fitness": network.fitness}
        rows.append(row | median(losses[-1]).columns("reestimated") | median(scores[-1]).columns("tested"))
    p_values = holm([mann_whitney(own, scores[0]).p for own in scores[1:]])
    for search, row, loss, score, p in zip(searches[1:], rows[1:], losses[1:], scores[1:], p_values, strict=True):
        rng = stream(0, "bootstrap", half, search.study.run)
        measures = superiority(loss, losses[0]).columns("lower_loss") | effects(score, scores[0], rng=rng)
        row.update(measures, p_holm=p)
    return pd.DataFrame(rows, columns=list(CHOSEN)).astype(CHOSEN)
