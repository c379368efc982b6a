"""All figures, by the picture of docs/found that shows them, or the page that says them."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from benchmarks.found import ends, networks, proposals, records
from benchmarks.found.estimates import Estimate, as_csv


def summary() -> Iterator[Estimate]:
    """Yield the rows of the picture of all questions, each under the question's number."""
    yield _row("1", "winners, both arms / baseline", records.pooled())
    yield _row("2", "mean of five, both arms / baseline", ends.mean_of_five())
    yield _row("2", "one of five, both arms / baseline", ends.one_of_five())
    yield _row("2", "the same, the method alone", next(ends.of_arms("of_one")))
    yield _row("2", "the same, without a search", ends.control())
    yield _row("3", "Claude's proposals / grammar's", proposals.claude_or_grammar())
    arms = {one.of: one for one in proposals.ablation_drawn()}
    yield _row("4", "random parents / the method", arms[proposals.NAMES["drift"]])
    yield _row("4", "best k, no niches / the method", arms[proposals.NAMES["best_k"]])
    for task, one in zip(("grating", "force"), networks.paper_means(), strict=True):
        yield _row("5", f"paper's {task} nets / baseline", one)
    told, _ = proposals.telling_drawn()
    yield _row("6", "told the losses / not told", told)
    yield _row("7", "children of elites / of others", proposals.children())
    first, *_ = networks.by_hand_drawn()
    yield _row("8", "two edits by hand / baseline", first)


def _row(question: str, of: str, one: Estimate) -> Estimate:
    return replace(one, of=f"{question}. {of}", group="", beside="")


Rows = Callable[[], Iterable[Estimate]]

#: What each picture shows, by its name.
DRAWN: dict[str, Rows] = {
    "summary": summary,
    "records": records.drawn,
    "ends": ends.drawn,
    "model_or_grammar": proposals.model_drawn,
    "ablation": proposals.ablation_drawn,
    "paper_networks": networks.paper_drawn,
    "telling": proposals.telling_drawn,
    "operator": proposals.operator_drawn,
    "by_hand": networks.by_hand_drawn,
    "words": proposals.words_drawn,
}

#: What the text of a page says beside its picture, by the name of the picture.
WRITTEN: dict[str, Rows] = {
    "records": records.written,
    "ends": ends.written,
    "model_or_grammar": proposals.model_written,
    "ablation": proposals.ablation_written,
    "operator": proposals.operator_written,
    "words": proposals.words_written,
}

#: The pages with another name than their picture.
PAGES = {"summary": "README", "model_or_grammar": "model"}


def table() -> bytes:
    """Return all figures as a table, `figures.csv`."""
    return as_csv(
        (f"{PAGES.get(name, name)}.md", picture, rows())
        for name in DRAWN
        for picture, rows in ((f"{name}.svg", DRAWN[name]), ("", WRITTEN.get(name, tuple)))
    )
