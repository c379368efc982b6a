"""An estimate: a number that a page of docs/found states, and all that a reader has to know of it."""

import csv
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass

from analysis.statistics.effects import mean_with_interval
from benchmarks.found.bundles import place_of

#: How an interval is named: of 95 % by Student, or the range of all values.
STUDENT, RANGE = "95 %", "lowest to highest"

#: What a plan had named before the data were made: this number, its outcome alone, or nothing.
PLANNED, OUTCOME, AFTERWARDS = "planned", "its outcome planned", "afterwards"


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A number with the ends of its interval, what it is of, and from where."""

    of: str
    value: float
    #: The ends of the interval, and what they are; none where the number stands alone.
    ends: tuple[float, float] | None = None
    interval: str = STUDENT
    #: Of how many values, and what one of them is.
    count: int
    unit: str
    #: The name of the published run, sweep or table.
    bundle: str
    #: What was fixed before the data were made (`PLANNED`, `OUTCOME` or `AFTERWARDS`).
    fixed: str
    #: How its numbers are written.
    form: str = "{:.2f}"
    #: The heading above its row in a picture.
    group: str = ""
    #: What stands behind its numbers in a picture.
    beside: str = ""

    def __str__(self) -> str:
        """Write the numbers as the pages do."""
        said = self.form.format(self.value)
        if self.ends is None:
            return said
        low, high = (self.form.format(end).removesuffix(" %") for end in self.ends)
        return f"{said} [{low}, {high}]" if self.interval != RANGE else f"{said} ({low} to {high})"


def ratio(of: str, logarithms: Iterable[float], *, unit: str, bundle: str, fixed: str) -> Estimate:
    """Return the geometric mean of ratios with Student's interval of their logarithms."""
    values = [*logarithms]
    mean, low, high = map(math.exp, mean_with_interval(values))
    return Estimate(of=of, value=mean, ends=(low, high), count=len(values), unit=unit, bundle=bundle, fixed=fixed)


#: The columns of the file of all figures.
COLUMNS = ("page", "picture", "of", "printed", "estimate", "low", "high", "interval", "n", "unit", "bundle", "fixed")


def as_csv(pages: Iterable[tuple[str, str, Iterable[Estimate]]]) -> bytes:
    """Write figures as a table, from page, picture and rows; of what stands in the text alone there is no picture.

    Numbers have four significant digits, which do not depend on the CPU.
    """
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(COLUMNS)
    table.writerows(_line(page, picture, row) for page, picture, rows in pages for row in rows)
    return out.getvalue().encode()


def _line(page: str, picture: str, row: Estimate) -> list[str]:
    of = f"{row.group}: {row.of}" if row.group else row.of
    numbers = [f"{number:.4g}" for number in (row.value, *(row.ends or ()))]
    numbers += [""] * (3 - len(numbers))
    known = [str(row.count), row.unit, str(place_of(row.bundle)), row.fixed]
    return [page, picture, of, str(row), *numbers, row.interval if row.ends else "", *known]
