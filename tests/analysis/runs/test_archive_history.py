"""Promise: the archive of every generation is rebuilt as the search had it, also where its bounds moved."""

import numpy as np
import pytest
from checkout import BUNDLES
from hand_runs import closed, rejected, run, trained

from analysis.report.collection import collect
from analysis.runs.archive_history import archive_history, archive_medians
from tacevo.bundles.open import opened
from tacevo.evolution.lines import GenerationLine
from tacevo.evolution.run_files import read_ledger
from tacevo.records import to_json
from tacevo.storage.canonical import content_hash
from tacevo.storage.run_directory import RunDirectory

#: Two niches, left and right.
HALVES = np.array([[0.25, 0.5], [0.75, 0.5]])


@pytest.mark.parametrize("name", [pytest.param("force-grammar.zip", marks=pytest.mark.slow), "grating-grammar.zip"])
def test_archives_are_those_of_the_ledger(name: str) -> None:
    """Every generation of a published run has the elites whose hash its line has; its bounds moved many times."""
    place = opened(BUNDLES / name)
    path = place.one_run("the test reads one run")
    collection = collect(path, place.store)
    recorded = [line.archive for line in read_ledger(RunDirectory(path)).lines if isinstance(line, GenerationLine)]
    archives = [archive.elites for archive in archive_history(collection.run, collection.niches.networks)]
    assert [content_hash({str(at): to_json(elites[at]) for at in elites}) for elites in archives] == recorded


def test_median_is_that_of_the_elites() -> None:
    """A worse candidate of a niche that is held counts among the new, and not in the archive."""
    slots = [
        trained(0, 0, 0.8, descriptors=(0.0, 0.0)),
        trained(0, 1, 0.6, descriptors=(1.0, 1.0)),
        trained(1, 0, 0.4, descriptors=(0.9, 0.5)),
        trained(1, 1, 5.0, descriptors=(0.1, 0.5)),
        rejected(1, 2),
    ]
    assert archive_medians(run(slots, [closed(0), closed(1)]), HALVES) == pytest.approx((0.7, 0.6))


def test_moved_bounds_put_elites_into_one_niche() -> None:
    """An outlier presses both elites into the left half, where only the better one stays."""
    slots = [
        trained(0, 0, 0.8, descriptors=(0.0, 0.0)),
        trained(0, 1, 0.6, descriptors=(1.0, 1.0)),
        trained(1, 0, 1.0, descriptors=(9.0, 0.5)),
    ]
    assert archive_medians(run(slots, [closed(0), closed(1)]), HALVES) == pytest.approx((0.7, 0.8))
    fixed = run(slots, [closed(0), closed(1)], archive={"bounds": "fixed"})
    assert archive_medians(fixed, HALVES) == pytest.approx((0.7, 0.7))


def test_archive_without_niches_has_a_median() -> None:
    """Of the best that it keeps, wherever they lie."""
    slots = [trained(0, 0, 0.8), trained(0, 1, 0.6), trained(1, 0, 0.2)]
    best = run(slots, [closed(0), closed(1)], archive={"kind": "best", "kept": 2}, bounds=None)
    assert archive_medians(best, np.empty((0, 2))) == pytest.approx((0.7, 0.4))


def test_archive_that_nothing_entered_has_no_median() -> None:
    """There is no fitness before the first training."""
    assert archive_medians(run([rejected(0, 0)], [closed(0, None, trained=0)], bounds=None), HALVES) == (None,)
