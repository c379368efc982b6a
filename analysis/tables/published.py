"""Tables of what the paper prints: its statistics beside the correct ones, and its searches beside ours.

A printed p stands for an interval: 0.0018 for everything that rounds to it, `<0.001` for everything below. Holm's
corrected values never fall when a p rises, so the correction of the intervals' ends bounds what a table may print.
"""

import json
from collections.abc import Sequence
from enum import StrEnum
from importlib.resources import files
from typing import Any

import pandas as pd

from analysis.rounding import shown
from analysis.runs.dynamics import improvement
from analysis.statistics.tests import holm
from analysis.table import Cell, Percent, PValue, Table, percent
from tacevo.parts.output import Output
from tacevo.results.run import RecordedRun
from tacevo.text import listed

#: What the paper prints. P-values are text, because their digits say how they were rounded.
PRINTED: dict[str, Any] = json.loads(files(__package__).joinpath("published.json").read_text(encoding="utf-8"))

#: Of each test.
_ROWS = "p, p after the correction"

ALPHA = 0.05

NOT_STATED = "not stated"


class Finding(StrEnum):
    """What a printed corrected p-value is worth; the values are what a table says."""

    agrees = "agrees"
    #: Below, or above, everything that the rounding of the printed p-values allows.
    too_small = "too small"
    too_large = "too large"
    #: The printed p is a bound, and what is printed is among what it allows.
    open = "not refuted by a bound"


class Published(Output):
    """Sets runs beside the published ones."""

    def beside(self, runs: Sequence[RecordedRun]) -> Sequence[Table]:
        """Make the table; none without runs."""
        return (beside_published(runs),) if runs else ()


def published_tables() -> tuple[Table, ...]:
    """Return all tables that need no run: both tests, the searches, the scores."""
    set_up = PRINTED["set-up"]
    searches = Table(
        name="published_searches",
        kind="published",
        caption="What the paper prints of its searches.",
        columns=("task", "trainable candidates", "improvement of the best fitness", "coverage"),
        rows=tuple(
            (task, Percent(one["trainable"]), Percent(one["improvement"]), Percent(one["coverage"]))
            for task, one in PRINTED["searches"].items()
        ),
        notes=(
            f"{set_up['generations']} generations of {set_up['candidates']} candidates, {set_up['epochs']} epochs "
            f"each, {set_up['model']}.",
        ),
    )
    scores = Table(
        name="published_scores",
        kind="published",
        caption="What the paper prints of its networks.",
        columns=("task", "network", "measure", "value"),
        rows=tuple(map(tuple, PRINTED["scores"])),
    )
    return (*map(_test_table, PRINTED["tests"]), searches, scores)


def beside_published(runs: Sequence[RecordedRun]) -> Table:
    """Set the results and the set-up of runs beside the published ones.

    Args:
        runs: one or more, of any task; of a task without a published search only ours is shown.
    """
    set_ups = {run.name: _set_up(run) for run in runs}
    return Table(
        name="beside_published",
        caption="Searches of this project beside the published ones.",
        columns=("run", "quantity", "published", "ours"),
        rows=tuple(
            (run.name, *row) for run in runs for row in (*_results(run), *(row[:3] for row in set_ups[run.name]))
        ),
        notes=(
            "The paper does not say against what the best fitness improved, so its figure stands beside both ours.",
            "Improvements compare single draws, one training seed a network, here and there.",
            "Trainable candidates: mean over the generations after the first, of first answers.",
            "The number of niches is not stated; the published coverages fit 25, 50 and 100.",
            *(
                f"Set up otherwise in {name}: {listed(row[0] for row in set_up if row[3])}."
                for name, set_up in set_ups.items()
            ),
        ),
    )


def corrected(rows: Sequence[tuple[str, str]]) -> pd.DataFrame:
    """Correct a table's printed p-values after Holm, and compare the printed corrections with the result.

    Args:
        rows: of each variant, p and p after the correction as they are printed, e.g. `0.0018` or `<0.001`.

    Returns:
        A row each: `holm`, of the p-values as they stand; `bound`, whether the correct value is known to lie below that
        only; `finding`; `changes`, whether the verdict at 0.05 is another by the correct value than by the printed one.
    """
    ends = [_range(p) for p, _ in rows]
    lows, highs = holm([low for low, _ in ends]), holm([high for _, high in ends])
    frame = pd.DataFrame({"holm": holm([_nominal(p) for p, _ in rows]), "bound": [_is_bound(p) for p, _ in rows]})
    printed = pd.Series([_nominal(adjusted) for _, adjusted in rows])
    return frame.assign(
        finding=[_finding(*row, low, high).value for row, low, high in zip(rows, lows, highs, strict=True)],
        changes=(printed <= ALPHA) != (frame.holm <= ALPHA),
    )


def _finding(p: str, adjusted: str, low: float, high: float) -> Finding:
    """Place what is printed beside the range of what would be correct."""
    least, most = _range(adjusted)
    if most < low:
        return Finding.too_small
    if least > high:
        return Finding.too_large
    return Finding.open if _is_bound(p) else Finding.agrees


def _is_bound(printed: str) -> bool:
    return printed.startswith("<")


def _nominal(printed: str) -> float:
    return float(printed.removeprefix("<"))


def _range(printed: str) -> tuple[float, float]:
    """Return the ends of what a printed probability may have been before it was rounded."""
    value = _nominal(printed)
    if _is_bound(printed):
        return 0.0, value
    half = 0.5 * 10.0 ** -len(printed.partition(".")[2])
    return max(0.0, value - half), min(1.0, value + half)


def _test_table(test: dict[str, Any]) -> Table:
    frame = corrected(test[_ROWS])
    frame.index = pd.Index([f"variant {number}" for number in range(1, len(frame) + 1)])
    wrong = frame.index[frame.finding.isin([Finding.too_small, Finding.too_large])]
    return Table(
        name=f"published_{test['task']}",
        kind="published",
        caption=f"{test['name']} of the paper ({test['task']}, {test['metric']}) beside Holm's correction of its "
        "p-values.",
        columns=("network", "p", "adjusted, printed", "adjusted, Holm", "printed value"),
        rows=tuple(
            (one.Index, *printed, f"<{shown(PValue(one.holm))}" if one.bound else PValue(one.holm), one.finding)
            for printed, one in zip(test[_ROWS], frame.itertuples(), strict=True)
        ),
        notes=(
            f"Mann-Whitney U against the baseline, {PRINTED['seeds']} training seeds each, as the paper reports it.",
            f"The printed table lacks the running maximum of Holm's method: {listed(wrong)}.",
            f"Verdicts at {ALPHA} that change: {listed(frame.index[frame.changes])}.",
            "A p printed as a bound gives a bound.",
        ),
    )


def _results(run: RecordedRun) -> tuple[tuple[str, Cell, Cell], ...]:
    """Return quantity, published and own value of what a search found."""
    theirs, ours = PRINTED["searches"].get(run.task, {}), improvement(run)
    return tuple(
        (quantity, percent(theirs.get(printed)), percent(ours.get(own)))
        for quantity, printed, own in (
            ("trainable candidates", "trainable", "trainable"),
            ("improvement on generation 0", "improvement", "over_first"),
            ("improvement on the baseline", "improvement", "over_baseline"),
            ("coverage", "coverage", "coverage"),
        )
    )


def _set_up(run: RecordedRun) -> tuple[tuple[str, Cell, Cell, bool], ...]:
    """Return quantity, published and own value of how a search was set up, and whether they differ.

    What the paper does not state counts as no difference, and of the data the form of the files does not count.
    """
    printed, config, source = PRINTED["set-up"], run.config, run.config.data.source
    images, stated = sum(run.facts.counts), PRINTED["searches"].get(run.task, {}).get("images")
    model = run.model if run.answered else "none was asked"
    simulated = run.config.data.facts.is_made

    def beside(quantity: str, name: str, value: int) -> tuple[str, Cell, Cell, bool]:
        return quantity, printed[name], value, printed[name] != value

    return (
        ("niches", NOT_STATED, run.places if run.has_niches else f"none; the best {run.places}", not run.has_niches),
        beside("candidates per generation", "candidates", config.search.candidates),
        beside("generations", "generations", config.search.generations),
        beside("epochs", "epochs", config.training.epochs),
        ("model", f"{printed['model']} ({printed['model id']})", model, model != printed["model id"]),
        ("data", printed["data"], source if simulated else f"{printed['data']} ({source})", simulated),
        ("images", stated or NOT_STATED, images, stated not in {None, images}),
        beside("image size in pixels", "image size", run.facts.image_size),
    )
