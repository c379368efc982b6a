"""Promise: a run without niches, or with one descriptor, is analysed as what it is."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import hand_runs
import numpy as np
import pytest
from hand_runs import altered
from refusals import refused
from smallest import SMALLEST, UNTRACKED

from analysis.runs.coverage_map import coverage_map, reachable
from analysis.runs.dynamics import progress
from analysis.runs.niches import Niches, load_niches
from analysis.tables.dynamics import generations_table
from tacevo.cli.app import main
from tacevo.errors import RunError
from tacevo.evolution.archive import find_centroids
from tacevo.results.run import RecordedRun
from tacevo.storage.canonical import content_hash

NO_NICHES = Niches(networks=np.empty((0, 2)), prompts=np.array([[0.5, 0.5]]))
TENTHS = (np.arange(10).reshape(-1, 1) + 0.5) / 10


def best_of_all() -> RecordedRun:
    """Make a run that keeps the three best of all."""
    candidates = [hand_runs.trained(0, slot, fitness=0.1 * (slot + 1)) for slot in range(3)]
    elite = hand_runs.elite("g00s00", niche=0, fitness=0.1)
    lines = [hand_runs.closed(0, 0.1, coverage=2 / 3)]
    archive = {"kind": "best", "kept": 3}
    return hand_runs.run(candidates, lines, elites=[elite], archive=archive, bounds=None)


def one_axis(*values: float) -> RecordedRun:
    """Make a run over the Efficiency Ratio alone, with candidates at these values."""
    candidates = [hand_runs.trained(0, slot, descriptors=(9.0, value)) for slot, value in enumerate(values)]
    archive = {"axes": ["eff_ratio"], "niches": 10}
    return hand_runs.run(candidates, [hand_runs.closed(0)], archive=archive, bounds=((0.0, 1.0),))


def test_run_of_before_has_niches_over_two_axes() -> None:
    """A configuration that knows none of the later settings is read as what it was."""
    run = hand_runs.run([], [])
    assert (run.has_niches, run.places, [str(axis) for axis in run.config.archive.axes]) == (
        True,
        4,
        ["arch_div", "eff_ratio"],
    )


def test_elites_without_niches_are_counted_in_places() -> None:
    """Two thirds of three places are two elites, and the table says what `new` means there."""
    run = best_of_all()
    assert progress(run).elites[0] == 2
    assert "found a place empty among the best 3" in generations_table(run, NO_NICHES.networks).notes[0]


@pytest.mark.room("figures")
@pytest.mark.parametrize(
    ("run", "niches", "words"),
    [
        (best_of_all(), NO_NICHES, "no network_map: archive.kind=best"),
        (one_axis(0.1, 0.9), replace(NO_NICHES, networks=TENTHS), "no network_map: archive.axes=eff_ratio"),
    ],
)
def test_map_that_would_mean_nothing_is_left_out_and_said(run: RecordedRun, niches: Niches, words: str) -> None:
    """No picture of cells where there are none, and a sentence in its stead; the others are there."""
    from analysis.report.figure_list import run_pictures, undrawn

    assert undrawn(hand_runs.run([], [])) == ()
    names = [picture.name for picture in run_pictures(run, niches)]
    assert "network_map" not in names
    assert {"archive_growth", "fitness", "prompt_map"} <= set(names)
    assert [sentence for sentence in undrawn(run) if sentence.startswith(words)]


@pytest.mark.parametrize(("archive", "networks", "axes"), [({"kind": "best"}, 0, 2), ({"axes": ["arch_div"]}, 3, 1)])
def test_niches_are_those_that_were_searched(archive: Any, networks: int, axes: int, tmp_path: Path) -> None:
    """An archive without niches has no centroids, one with a single descriptor one number each; others are refused."""
    shape = {"niches": 3, "prompt_niches": 2, "samples": 50, "seed": 0, **archive}
    prompts = find_centroids(niches=2, dimensions=2, samples=50, seed=0)
    own = find_centroids(niches=networks, dimensions=axes, samples=50, seed=0) if networks else []
    run = altered(hand_runs.run([], [], archive=shape), centroids=content_hash([own, prompts]))
    assert load_niches(run.with_store(str(tmp_path))).networks.shape == (networks, axes)
    with refused(RunError, expected="the niches that runs/hand was searched with"):
        load_niches(altered(run, centroids=content_hash([prompts, prompts])).with_store(str(tmp_path)))


@pytest.mark.room("alarms")
def test_alarms_of_niches_need_niches() -> None:
    """Without niches nothing is said of them, however alike the descriptors are."""
    from analysis.runs.health import alarms

    told = {alarm.name for alarm in alarms(best_of_all(), NO_NICHES.networks)}
    assert not told & {"few reachable niches", "crowded niche", "constant ArchDiv", "constant EffRatio"}


def test_reachable_niches_of_one_axis_lie_between_the_ends() -> None:
    """Candidates at 0.25 and 0.65 reach the tenths from the third to the seventh."""
    placed = coverage_map(one_axis(0.25, 0.65), TENTHS)
    assert placed.points.tolist() == [[0.25], [0.65]]
    assert reachable(placed, TENTHS) == frozenset(range(2, 7))


@pytest.mark.room("alarms")
def test_alarm_of_one_axis_names_that_axis() -> None:
    """A descriptor that tells nothing apart is called by its own name, and the unused one not at all."""
    from analysis.runs.health import alarms

    told = {alarm.name for alarm in alarms(one_axis(*[0.5] * 9), TENTHS)}
    assert "constant EffRatio" in told
    assert "constant ArchDiv" not in told


@pytest.mark.parametrize(
    "arm",
    [
        *(pytest.param(arm, marks=pytest.mark.slow) for arm in ("no_qd", "random_sampling")),
        *(
            pytest.param(arm, marks=pytest.mark.long)
            for arm in ("arch_div_only", "random_parents_only_baseline", "drift", "best_k")
        ),
    ],
)
def test_every_command_reads_a_run_of_an_arm(arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Search, replay, show, tables, figures and report all end well on a real run, which its budget ends."""
    sizes = ["search.generations=9", "search.candidates=2", "search.initial=1", f"ablation={arm}"]
    sizes.append("search.training_flops=2.2e9")  # three trainings of the baseline, so after generation 1 or 2
    run = str(tmp_path / "run")
    assert main(["search", *SMALLEST, UNTRACKED, *sizes, f"run.dir={run}", f"store.root={tmp_path / 'cache'}"]) == 0
    for command in ("replay", "show", "tables", "figures", "report"):
        assert main([command, run]) == 0
    assert ("no network_map" in capsys.readouterr().err) == (arm in {"no_qd", "arch_div_only"})
