"""Do parents by a lower bound help? A way of our own (`benchmarks.bounded_parents`), on the table of a space.

    python -m benchmarks.bounds                    # the figures of the searches in results/bounds.json
    python -m benchmarks.bounds --searches 400     # searches until so many of each way are recorded

All is as in `benchmarks.reach`, whose searches of the same seeds are the rivals: ten epochs a training, one network
handed over after each budget, judged by seeds that have not chosen it. The search as published has the same first
generation and the same noise, so it is compared in pairs. Half of the trainings are asked, too: what is handed over
after 200 epochs, beside the rival's after 400.
"""

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from analysis.statistics.tests import holm
from benchmarks import reach
from benchmarks.bounded_parents import LowerBound
from benchmarks.judging import Mean, Space, mean, of_budget, p_value, written
from benchmarks.reach import BUDGETS, Way, searched
from tacevo.config.compose import compose
from tacevo.results.space_table import read_table

RESULTS = Path(__file__).with_name("results") / "bounds.json"

WAYS = {
    "parents of the lowest bound": LowerBound(),
    "parents of the lowest estimate": LowerBound(deviations=0.0),
}

#: The rivals among the ways of `benchmarks.reach`; the first is met in pairs.
PUBLISHED, DRAWS = "as published, 10 epochs", "draws, 10 epochs"

EPOCHS = 10


def ways_of(space: Space, store: Path) -> dict[str, Way]:
    """Return both ways, by name; they share a store."""

    def way(parents: LowerBound) -> Way:
        given = (f"training.epochs={EPOCHS}", f"store.root={store}")
        return Way(EPOCHS, lambda seed, trainings: searched(space, seed, trainings, given, parents))

    return {name: way(parents) for name, parents in WAYS.items()}


def comparisons(
    space: Space, ways: Mapping[str, Any], rivals: Mapping[str, Any]
) -> Iterator[tuple[str, str, int, int, Mean]]:
    """Yield each comparison: way, rival, the epochs of both, and the difference of their mean log test losses."""
    last = len(BUDGETS) - 1
    for name, found in ways.items():
        count = len(found["searches"])
        for rival in (PUBLISHED, DRAWS):
            for own, other in [(number, number) for number in range(last + 1)] + [(last - 1, last)]:
                against, paired = of_budget(rivals[rival], other), rival == PUBLISHED
                difference = mean(space, of_budget(found, own), against[:count] if paired else against, paired=paired)
                yield name, rival, BUDGETS[own], BUDGETS[other], difference


def table_lines(space: Space, ways: Mapping[str, Any], rivals: Mapping[str, Any]) -> Iterator[str]:
    """Yield the table of all comparisons, with p values before and after Holm over all of them."""
    found = [*comparisons(space, ways, rivals)]
    p = [p_value(one) for *_, one in found]
    yield "| way | epochs | beside | epochs | loss, of theirs [95 %] | p | after Holm |"
    yield f"|{'---|' * 7}"
    for (name, rival, own, other, one), single, corrected in zip(found, p, holm(p), strict=True):
        beside = f"{rival.partition(',')[0]} | {other}"
        yield f"| {name} | {own} | {beside} | {written(one)} | {single:.3g} | {corrected:.3g} |"


def main() -> None:
    """Search on, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--searches", type=int, default=0, metavar="N", help="of each way, those recorded included")
    options = parser.parse_args()
    space = Space(read_table(Path(compose(["experiment=table"]).data.root or "")))
    rivals = reach.reach(space, reach.RESULTS, 0, 0)  # as they are recorded
    least, most = 2, len(rivals[PUBLISHED]["searches"])
    if options.searches and not least <= options.searches <= most:
        parser.error(f"--searches: expected {least} to {most}, which have a rival each; got {options.searches}")
    if not options.searches and not RESULTS.exists():
        parser.error(f"no searches are recorded in {RESULTS}; give --searches")
    ways = reach.reach(space, RESULTS, options.searches, 0, ways_of)
    print("\n".join(table_lines(space, ways, rivals)))


if __name__ == "__main__":
    main()
