"""The terms that a study's variants are judged by, stated before anything is trained."""

import itertools
import math
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Gt, Lt

from tacevo.config.study import Margin
from tacevo.records import Record
from tacevo.rounding import rounded


def fewest_seeds(alpha: float) -> int:
    """Return the least S for which a two-sided rank test of S values against S can be significant at a level alpha.

    Of the C(2S, S) orders, which are equally likely without a difference, the two extreme ones have the smallest p.
    """
    return next(seeds for seeds in itertools.count(1) if rounded(2 / math.comb(2 * seeds, seeds)) <= alpha)


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms(Record):
    """How a study is judged."""

    #: Level of the tests, in (0, 1); each family of p-values keeps it as a whole.
    alpha: Annotated[float, Gt(0), Lt(1)]
    #: Of equivalence, in the study's primary metric.
    margin: Margin
