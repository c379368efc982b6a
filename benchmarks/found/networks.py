"""Networks that no search found: the paper's, rebuilt, and the baseline with two edits by hand."""

from collections.abc import Iterator
from dataclasses import replace

from benchmarks.found.bundles import run
from benchmarks.found.estimates import AFTERWARDS, PLANNED, Estimate, ratio
from benchmarks.handed_over import against_baseline

_TRAININGS = "trainings"

#: The studies of the paper's networks, by task.
PAPER = {
    "grating-variants": "gratings, 12 epochs, 20 seeds",
    "force-variants": "forces, 10 epochs, 20 seeds",
}

#: The studies of the edits by hand, and whether a plan had named them.
BY_HAND = {
    "grating-by-hand": ("the demo's task, 32 px", AFTERWARDS),
    "grating-by-hand-48": ("harder task, 48 px", AFTERWARDS),
    "grating-chosen-48": ("the same, new images", PLANNED),
}


def paper_drawn() -> Iterator[Estimate]:
    """Yield the test losses of the paper's networks beside the baseline's, and the verdict of the corrected test."""
    for name, group in PAPER.items():
        (study,) = run(name).studies
        for network, logs in against_baseline(study.scores).items():
            row = ratio(_spelt(str(network)), logs, unit=_TRAININGS, bundle=name, fixed=AFTERWARDS)
            yield replace(row, group=group, beside=str(study.verdicts.verdict[network]))


def _spelt(network: str) -> str:
    """Write the name of a network as the pages do: `variant 1`."""
    return network.replace("variant", "variant ")


def paper_means() -> Iterator[Estimate]:
    """Yield the mean of the four networks of each task."""
    for name, group in PAPER.items():
        (study,) = run(name).studies
        logs = against_baseline(study.scores).mean(axis=1)
        yield ratio(f"mean of four, {group}", logs, unit=_TRAININGS, bundle=name, fixed=AFTERWARDS)


def by_hand_drawn() -> Iterator[Estimate]:
    """Yield the test losses of two edits by hand on three sets of images."""
    for name, (of, fixed) in BY_HAND.items():
        (study,) = run(name).studies
        row = ratio(of, against_baseline(study.scores).by_hand, unit=_TRAININGS, bundle=name, fixed=fixed)
        yield replace(row, group="gratings, 70 epochs")
