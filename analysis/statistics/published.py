"""The figures that the paper prints, as data, and Holm's correction compared with its tables.

AbuSadeh, Wei & Zhang (docs/references.bib). P-values are kept as they are printed, because a printed number stands for
an interval: 0.0018 for everything that rounds to it, `<0.001` for everything below. Holm's corrected values never
fall when a p rises, so the correction of the intervals' ends bounds what a table may print, and a printed value
below that is too small for any rounding.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from analysis.statistics.tests import holm


@dataclass(frozen=True, slots=True, kw_only=True)
class PrintedRow:
    """A variant of Table II or III."""

    variant: str
    #: As printed, e.g. `0.0018` or `<0.001`.
    p: str
    #: After the correction, as printed.
    adjusted: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PrintedTest:
    """Table II or III: four variants against the baseline, 20 training seeds each."""

    task: str
    #: `Table II` or `Table III`.
    name: str
    #: What is compared, e.g. `test MSE`.
    metric: str
    rows: tuple[PrintedRow, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PrintedSearch:
    """What the paper prints of a search: fractions in [0, 1]."""

    task: str
    #: Candidates that could be trained, mean over generations.
    trainable: float
    #: By how much the best fitness improved; against what is not said.
    improvement: float
    #: Occupied part of the network archive's niches at the end.
    coverage: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PrintedScore:
    """A network's printed result."""

    task: str
    network: str
    #: E.g. `test MSE, median of 20 seeds`.
    measure: str
    #: As printed.
    value: str


class Finding(StrEnum):
    """What a printed corrected p-value is worth; the values are what a table says."""

    agrees = "agrees"
    #: Below, or above, everything that the rounding of the printed p-values allows.
    too_small = "too small"
    too_large = "too large"
    #: The printed p is a bound, and what is printed is among what it allows.
    open = "not refuted by a bound"


@dataclass(frozen=True, slots=True, kw_only=True)
class Corrected:
    """A printed row beside what Holm's correction makes of the printed p-values."""

    row: PrintedRow
    #: Of the printed p-values as they stand; a bound where the row's p is one.
    holm: float
    finding: Finding

    @property
    def bound(self) -> bool:
        """Whether the correct value is known to lie below `holm` only."""
        return _is_bound(self.row.p)


ALPHA = 0.05

SEEDS = 20


def _printed(task: str, name: str, metric: str, *rows: tuple[str, str]) -> PrintedTest:
    """Number the variants of a table, each with its p and its corrected p."""
    variants = enumerate(rows, start=1)
    found = tuple(PrintedRow(variant=f"variant {number}", p=p, adjusted=adjusted) for number, (p, adjusted) in variants)
    return PrintedTest(task=task, name=name, metric=metric, rows=found)


FORCE = _printed(
    *("force", "Table II", "test MSE"), ("<0.001", "<0.001"), ("<0.001", "<0.001"), ("0.25", "0.25"), ("0.20", "0.40")
)

GRATING = _printed(
    *("grating", "Table III", "test accuracy"),
    *(("0.0018", "0.0055"), ("0.0064", "0.0064"), ("0.0015", "0.0060"), ("0.0041", "0.0082")),
)

TESTS = (FORCE, GRATING)

SEARCHES = (
    PrintedSearch(task="force", trainable=0.960, improvement=0.561, coverage=0.880),
    PrintedSearch(task="grating", trainable=0.945, improvement=0.961, coverage=0.920),
)

#: How the searches were set up; the number of niches is not stated.
CANDIDATES = 50

GENERATIONS = 20

EPOCHS = 10

MODEL = "Claude 3 Haiku"

#: Under which it is served.
MODEL_ID = "claude-3-haiku-20240307"

DATA = "recorded"

IMAGE_SIZE = 256

IMAGES = {"force": 3_000, "grating": 3_507}

SCORES = (
    PrintedScore(task="force", network="baseline", measure="test MSE, median of 20 seeds", value="0.006"),
    PrintedScore(task="grating", network="baseline", measure="test accuracy, median of 20 seeds", value="99.7 %"),
    PrintedScore(task="grating", network="variant 1", measure="test accuracy, median of 20 seeds", value="100.0 %"),
    PrintedScore(task="grating", network="variant 3", measure="test accuracy, median of 20 seeds", value="100.0 %"),
    PrintedScore(task="hardness", network="baseline", measure="MSE", value="0.1846"),
    PrintedScore(task="hardness", network="baseline", measure="MAE", value="0.3112"),
    PrintedScore(task="hardness", network="baseline", measure="R²", value="0.9902"),
    PrintedScore(task="hardness", network="baseline", measure="RMSE", value="0.4297"),
)


def corrected(test: PrintedTest) -> tuple[Corrected, ...]:
    """Correct a table's printed p-values after Holm, and compare the printed corrections with the result."""
    lows = holm([_range(row.p)[0] for row in test.rows])
    nominal = holm([_nominal(row.p) for row in test.rows])
    highs = holm([_range(row.p)[1] for row in test.rows])
    return tuple(
        Corrected(row=row, holm=value, finding=_finding(row, low, high))
        for row, value, low, high in zip(test.rows, nominal, lows, highs, strict=True)
    )


def verdicts_that_change(rows: Sequence[Corrected]) -> tuple[str, ...]:
    """Name the variants whose significance at 0.05 is another by the correct value than by the printed one."""
    return tuple(one.row.variant for one in rows if (_nominal(one.row.adjusted) <= ALPHA) != (one.holm <= ALPHA))


def _finding(row: PrintedRow, low: float, high: float) -> Finding:
    """Place what is printed beside the range of what would be correct."""
    least, most = _range(row.adjusted)
    if most < low:
        return Finding.too_small
    if least > high:
        return Finding.too_large
    return Finding.open if _is_bound(row.p) else Finding.agrees


def _is_bound(printed: str) -> bool:
    return printed.startswith("<")


def _nominal(printed: str) -> float:
    """Return the number that is printed; of a bound, the bound."""
    return float(printed.removeprefix("<"))


def _range(printed: str) -> tuple[float, float]:
    """Return the ends of what a printed probability may have been before it was rounded."""
    value = _nominal(printed)
    if _is_bound(printed):
        return 0.0, value
    half = 0.5 * 10.0 ** -len(printed.partition(".")[2])
    return max(0.0, value - half), min(1.0, value + half)
