"""Promise: what counts as reachable is what the run's own temperature rule can lead to, and nothing else."""

from dataclasses import replace

import hand_runs
import numpy as np
import pytest
from checkout import BUNDLES

from analysis.report.collection import collect
from analysis.runs.niches import Niches, prompt_rows, reachable_prompt_niches, reachable_temperatures
from tacevo.bundles.open import opened
from tacevo.evolution.archive import Tessellation, find_centroids
from tacevo.evolution.lines import CandidateLine
from tacevo.evolution.prompts import prompt_point
from tacevo.evolution.run_files import read_finished
from tacevo.records import Json
from tacevo.results.run import RecordedRun
from tacevo.storage.run_directory import RunDirectory


def run_of(generations: int, **temperature: Json) -> RecordedRun:
    """Make a run under a temperature rule."""
    bare = hand_runs.run([], [hand_runs.closed(number) for number in range(generations + 1)])
    return replace(bare, config=hand_runs.configured(temperature=temperature))


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        ("paper", {0.6, 0.65, 0.7}),
        ("fixed", {0.6}),
        ("stall", {0.5, 0.55, 0.6, 0.65, 0.7}),
    ],
)
def test_temperatures_follow_from_the_rule(rule: str, expected: set[float]) -> None:
    """In three generations: two steps up, none, or two steps either way."""
    assert reachable_temperatures(run_of(3, rule=rule)) == expected


def test_temperatures_follow_from_start_and_step_and_end_at_the_limits() -> None:
    """A step that leads beyond 1 or 0 is cut there, as in the search."""
    assert reachable_temperatures(run_of(4, rule="paper", start=0.2, step=0.3)) == {0.2, 0.5, 0.8, 1.0}
    assert reachable_temperatures(run_of(2, rule="stall", start=0.1, step=0.3)) == {0.1, 0.0, 0.4}


def test_run_without_trials_reaches_nothing() -> None:
    """The mutations of generation 0 are not trials."""
    run = run_of(0, rule="stall")
    assert reachable_temperatures(run) == frozenset()
    assert reachable_prompt_niches(run, np.array([[0.5, 0.5]])) == frozenset()


@pytest.mark.room("figures")
@pytest.mark.parametrize(("centroids", "shaded"), [([[0.5, 0.6]], False), ([[0.5, 0.6], [0.5, 0.1]], True)])
def test_caption_explains_shaded_niches_where_there_are_some(centroids: list[list[float]], shaded: bool) -> None:
    """It depends on the niches that were out of reach; of a map without them nothing is said."""
    from analysis.report.figure_list import run_pictures

    run = hand_runs.run([hand_runs.trained(0, 0), hand_runs.trained(1, 0)], [hand_runs.closed(0), hand_runs.closed(1)])
    niches = Niches(networks=np.array([[0.5, 0.5]]), prompts=np.array(centroids))
    (caption,) = (one.caption for one in run_pictures(run, niches) if one.name == "prompt_map")
    assert ("shaded ones" in caption) is shaded


@pytest.mark.slow
@pytest.mark.parametrize("name", ["force-grammar.zip", "grating-grammar.zip"])
def test_trials_of_a_search_lie_within_reach(name: str) -> None:
    """Every one that a published run recorded does, without the noise of its request; half of the niches do not."""
    place = opened(BUNDLES / name)
    path = place.one_run("the test reads one run")
    collection = collect(path, place.store)
    _, ledger = read_finished(RunDirectory(path))
    lines = [line for line in ledger.lines if isinstance(line, CandidateLine) and line.prompt_niche is not None]
    run, centroids = collection.run, collection.niches.prompts
    reached = reachable_prompt_niches(run, centroids)
    assert len(reached) == len(centroids) / 2
    assert {line.prompt_niche for line in lines} <= reached
    temperature = {line.generation: line.temperature for line in run.generations}
    for line in lines:
        assert line.prompt is not None
        point = prompt_point(line.prompt, temperature[line.generation], prompts=len(run.instructions))
        assert Tessellation(centroids).niche_of(point) == line.prompt_niche


@pytest.mark.parametrize("prompts", [1, 2, 5, 17])
def test_rows_of_instructions_are_cut_as_the_archive_looks_up(prompts: int) -> None:
    """Each row is covered once from 0 to 1, and within a piece the archive finds its niche."""
    centroids = np.array(find_centroids(niches=12, dimensions=2, samples=400, seed=prompts))
    rows = prompt_rows(centroids, prompts)
    assert len(rows) == prompts
    for prompt, row in enumerate(rows):
        assert [low for _, low, _ in row] == pytest.approx([0.0, *(high for _, _, high in row[:-1])])
        assert row[-1][2] == 1.0
        middles = [prompt_point(prompt, (low + high) / 2, prompts=prompts) for _, low, high in row]
        assert list(Tessellation(centroids).niches_of(middles)) == [niche for niche, _, _ in row]


def test_row_through_equal_centroids_belongs_to_the_first() -> None:
    """Two that lie at equal distance all along a row are one piece, that of the first, as in the archive."""
    assert prompt_rows(np.array([[0.4, 0.5], [0.6, 0.5], [0.5, 9.0]]), 3)[1] == ((0, 0.0, 1.0),)
