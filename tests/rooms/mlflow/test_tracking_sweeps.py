"""In MLflow the searches of a sweep are nested under one run, and stand side by side with what compares them."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier

import pytest
from mirrored import LINES, build_run, build_sweep, everything, mirror_once

from tacevo.storage.sweep_directory import SweepDirectory

#: The filter of docs/tracking.md.
SEARCHES = "tags.`tacevo.sweep` = 'sweep' and tags.`tacevo.arm` LIKE '%'"


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    """Return a sweep of two arms, of which the first seeds are done."""
    build_sweep(tmp_path / "sweep", LINES)
    return tmp_path / "sweep"


def test_searches_are_nested_under_their_sweep_and_stand_side_by_side(sweep: Path, uri: str) -> None:
    """Sweep, search, candidate; the sweep is running, because two of its jobs have not begun.

    One filter lists the searches, without their candidates, with arm, seed and final figures.
    """
    from mlflow import MlflowClient

    for name in ("none-seed0", "greedy-seed0"):
        mirror_once(sweep / name, uri)
    shown = everything(uri)
    searches = {("sweep", "none-seed0"), ("sweep", "greedy-seed0")}
    assert {path for path in shown if len(path) < 3} == {("sweep",), *searches}
    assert ("sweep", "none-seed0", "g00s00") in shown
    _, status, params, tags, _, _ = shown["sweep",]
    assert (status, params, tags["tacevo.sweep"]) == ("RUNNING", {"overrides": "experiment=demo"}, "sweep")
    client = MlflowClient(uri)
    experiment = client.get_experiment_by_name("tacevo")
    assert experiment is not None
    beside = client.search_runs([experiment.experiment_id], SEARCHES, order_by=["tags.`tacevo.arm` ASC"])
    assert [(run.data.tags["tacevo.arm"], run.data.tags["tacevo.seed"]) for run in beside] == [
        ("greedy", "0"),
        ("none", "0"),
    ]
    final = {"best": 0.25, "improvement": 0.0, "coverage": 0.01, "qd_score": 0.8, "trained_candidates": 2.0}
    assert [{key: run.data.metrics[key] for key in final} for run in beside] == [final, final]


def test_sweep_ends_with_its_last_job_and_runs_again_with_more(sweep: Path, uri: str) -> None:
    """When every job is finished, so is the sweep's run; jobs and workers that come later change no other run."""
    directory = SweepDirectory(sweep)
    whole = directory.read()
    directory.write(replace(whole, jobs=whole.jobs[:1]))
    mirror_once(sweep / "none-seed0", uri)
    first = everything(uri)
    assert first["sweep",][1] == "FINISHED"
    directory.write(replace(whole, overrides=(*whole.overrides, "executor.workers=4")))
    mirror_once(sweep / "none-seed0", uri)
    second = everything(uri)
    assert second.pop(("sweep",))[1] == "RUNNING"
    assert second == {path: said for path, said in first.items() if path != ("sweep",)}


def test_equal_searches_of_two_sweeps_are_two_runs(sweep: Path, tmp_path: Path, uri: str) -> None:
    """A job of the same name, settings and seed in another sweep does not take the first one's place."""
    build_sweep(tmp_path / "other", LINES)
    mirror_once(sweep / "none-seed0", uri)
    mirror_once(tmp_path / "other" / "none-seed0", uri)
    assert {path for path in everything(uri) if len(path) == 2} == {("sweep", "none-seed0"), ("other", "none-seed0")}


def test_run_beside_the_jobs_of_a_sweep_stands_alone(sweep: Path, uri: str) -> None:
    """Only what sweep.json names is nested."""
    build_run(sweep / "trial", LINES[:2])
    mirror_once(sweep / "trial", uri)
    assert set(everything(uri)) == {("trial",), ("trial", "g00s00")}


def test_jobs_that_begin_at_once_share_one_sweep(sweep: Path, uri: str) -> None:
    """On one machine, one run is created, however many mirrors look for it at the same moment."""
    from tacevo.tracking.mirror import find_job, join_sweep
    from tacevo.tracking.store import PARENT_TAG, Store

    member = find_job(sweep / "none-seed0")
    assert member is not None
    Store.open(uri, "tacevo")
    barrier = Barrier(4)

    def join(_: int) -> str:
        store = Store.open(uri, "tacevo")
        barrier.wait()
        return join_sweep(store, *member)[PARENT_TAG]

    with ThreadPoolExecutor(4) as pool:
        assert len(set(pool.map(join, range(4)))) == 1
