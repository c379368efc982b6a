"""Tables of what the paper prints: its statistics beside the correct ones, and its searches beside ours."""

from collections.abc import Sequence
from dataclasses import dataclass

from analysis.rounding import shown
from analysis.runs.dynamics import improvement
from analysis.statistics import published
from analysis.statistics.published import Corrected, Finding, PrintedTest, corrected, verdicts_that_change
from analysis.table import Cell, Percent, PValue, Table, percent
from tacevo.choices import DataSource
from tacevo.results.run import RecordedRun
from tacevo.text import listed

#: What is set beside each other of a search.
RESULTS = ("trainable candidates", "improvement on generation 0", "improvement on the baseline", "coverage")

UNKNOWN = (None,) * len(RESULTS)

NOT_STATED = "not stated"


def published_tables() -> tuple[Table, ...]:
    """Return all tables that need no run: both tests, the searches, the scores."""
    return (*(_test_table(test) for test in published.TESTS), _searches_table(), _scores_table())


def beside_published(runs: Sequence[RecordedRun]) -> Table:
    """Set the results and the set-up of runs beside the published ones.

    Args:
        runs: one or more, of any task; of a task without a published search only ours is shown.

    Raises:
        ValueError: the list is empty.
    """
    if not runs:
        raise ValueError("a table beside the published figures needs at least one run; got none")
    return Table(
        name="beside_published",
        caption="Searches of this project beside the published ones.",
        columns=("run", "quantity", "published", "ours"),
        rows=tuple((run.name, *row) for run in runs for row in _rows(run)),
        notes=(
            "The paper does not say against what the best fitness improved, so its figure stands beside both ours.",
            "Improvements compare single draws, one training seed a network, here and there.",
            "Trainable candidates: mean over the generations after the first, of first answers.",
            "The number of niches is not stated; the published coverages fit 25, 50 and 100.",
            *(_differences(run) for run in runs),
        ),
    )


def _test_table(test: PrintedTest) -> Table:
    rows = corrected(test)
    wrong = [found.row.variant for found in rows if found.finding in {Finding.too_small, Finding.too_large}]
    changed = verdicts_that_change(rows)
    return Table(
        name=f"published_{test.task}",
        caption=f"{test.name} of the paper ({test.task}, {test.metric}) beside Holm's correction of its p-values.",
        columns=("network", "p", "adjusted, printed", "adjusted, Holm", "printed value"),
        rows=tuple(
            (found.row.variant, found.row.p, found.row.adjusted, _holm_cell(found), found.finding.value)
            for found in rows
        ),
        notes=(
            f"Mann-Whitney U against the baseline, {published.SEEDS} training seeds each, as the paper reports it.",
            f"The printed table lacks the running maximum of Holm's method: {listed(wrong)}.",
            f"Verdicts at {published.ALPHA} that change: {listed(changed)}.",
            "A p printed as a bound gives a bound.",
        ),
    )


def _holm_cell(found: Corrected) -> Cell:
    return f"<{shown(PValue(found.holm))}" if found.bound else PValue(found.holm)


def _searches_table() -> Table:
    return Table(
        name="published_searches",
        caption="What the paper prints of its searches.",
        columns=("task", "trainable candidates", "improvement of the best fitness", "coverage"),
        rows=tuple(
            (search.task, Percent(search.trainable), Percent(search.improvement), Percent(search.coverage))
            for search in published.SEARCHES
        ),
        notes=(
            f"{published.GENERATIONS} generations of {published.CANDIDATES} candidates, {published.EPOCHS} epochs "
            f"each, {published.MODEL}.",
        ),
    )


def _scores_table() -> Table:
    return Table(
        name="published_scores",
        caption="What the paper prints of its networks.",
        columns=("task", "network", "measure", "value"),
        rows=tuple((score.task, score.network, score.measure, score.value) for score in published.SCORES),
    )


def _rows(run: RecordedRun) -> tuple[tuple[str, Cell, Cell], ...]:
    """Return quantity, published and own value of all that is set beside each other."""
    return (*_results(run), *((one.quantity, one.published, one.ours) for one in _set_up(run)))


def _results(run: RecordedRun) -> tuple[tuple[str, Cell, Cell], ...]:
    """Return quantity, published and own value of what a search found."""
    printed = next((search for search in published.SEARCHES if search.task == run.task), None)
    found = improvement(run)
    theirs = printed and (printed.trainable, printed.improvement, printed.improvement, printed.coverage)
    ours = found and (found.trainable, found.over_first, found.over_baseline, found.coverage)
    return tuple(
        (quantity, percent(published_share), percent(own_share))
        for quantity, published_share, own_share in zip(RESULTS, theirs or UNKNOWN, ours or UNKNOWN, strict=True)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Setting:
    """One quantity of how a search was set up."""

    quantity: str
    published: Cell
    ours: Cell
    differs: bool


def _set_up(run: RecordedRun) -> tuple[_Setting, ...]:
    """List how a search was set up; what the paper does not state counts as no difference."""
    config = run.config
    images, stated = sum(run.facts.counts), published.IMAGES.get(run.task)
    return (
        _niches(run),
        _equal("candidates per generation", published.CANDIDATES, config.search.candidates),
        _equal("generations", published.GENERATIONS, config.search.generations),
        _equal("epochs", published.EPOCHS, config.training.epochs),
        _model(run.model if run.answered else "none was asked"),
        _data(config.data.source),
        _Setting(quantity="images", published=stated or NOT_STATED, ours=images, differs=stated not in {None, images}),
        _equal("image size in pixels", published.IMAGE_SIZE, run.facts.image_size),
    )


def _niches(run: RecordedRun) -> _Setting:
    """Compare the archives; the paper's has niches, whose number it does not state."""
    ours = run.places if run.has_niches else f"none; the best {run.places}"
    return _Setting(quantity="niches", published=NOT_STATED, ours=ours, differs=not run.has_niches)


def _equal(quantity: str, theirs: int, ours: int) -> _Setting:
    return _Setting(quantity=quantity, published=theirs, ours=ours, differs=theirs != ours)


def _model(name: str) -> _Setting:
    printed = f"{published.MODEL} ({published.MODEL_ID})"
    return _Setting(quantity="model", published=printed, ours=name, differs=name != published.MODEL_ID)


def _data(source: DataSource) -> _Setting:
    """Compare simulated with recorded; the form of the files does not count."""
    simulated = source is DataSource.simulated
    ours = source.value if simulated else f"{published.DATA} ({source})"
    return _Setting(quantity="data", published=published.DATA, ours=ours, differs=simulated)


def _differences(run: RecordedRun) -> str:
    """Name what was set up otherwise."""
    differing = [setting.quantity for setting in _set_up(run) if setting.differs]
    return f"Set up otherwise in {run.name}: {listed(differing)}."
