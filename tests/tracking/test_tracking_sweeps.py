"""In MLflow the searches of a sweep are nested under one run, and stand side by side with what compares them."""

import json
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier

import pytest
from mirrored import ENTRIES, GENERATION, SECOND_GENERATION, build_run, build_sweep, everything, mirror_once
from mounts import read_only

from tacevo.costs import Spending
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.tracking.entries import Measure, Totals, total_measures

# MLflow uses a loader option of SQLAlchemy that its newest version deprecates.
pytestmark = pytest.mark.filterwarnings("ignore:The ``noload`` loader strategy is deprecated")

#: The filter of docs/tracking.md.
SEARCHES = "tags.`tacevo.sweep` = 'sweep' and tags.`tacevo.arm` LIKE '%'"


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    """Give a sweep of two arms, of which the first seeds are done."""
    build_sweep(tmp_path / "sweep", ENTRIES)
    return tmp_path / "sweep"


def test_searches_are_nested_under_their_sweep(sweep: Path, uri: str) -> None:
    """Sweep, search, candidate; the sweep goes on, for two of its jobs are not begun."""
    for name in ("none-seed0", "greedy-seed0"):
        mirror_once(sweep / name, uri)
    said = everything(uri)
    assert {path for path in said if len(path) < 3} == {("sweep",), ("sweep", "none-seed0"), ("sweep", "greedy-seed0")}
    assert ("sweep", "none-seed0", "g00s00") in said
    _, status, params, tags, _, _ = said["sweep",]
    assert (status, params, tags["tacevo.sweep"]) == ("RUNNING", {"overrides": "experiment=demo"}, "sweep")


def test_searches_of_a_sweep_stand_side_by_side(sweep: Path, uri: str) -> None:
    """One filter lists them, without their candidates, with arm, seed and final figures."""
    from mlflow import MlflowClient

    for name in ("none-seed0", "greedy-seed0"):
        mirror_once(sweep / name, uri)
    client = MlflowClient(uri)
    experiment = client.get_experiment_by_name("tacevo")
    assert experiment is not None
    found = client.search_runs([experiment.experiment_id], SEARCHES, order_by=["tags.`tacevo.arm` ASC"])
    assert [run.data.tags["tacevo.arm"] for run in found] == ["greedy", "none"]
    assert {run.data.tags["tacevo.seed"] for run in found} == {"0"}
    final = {"best": 0.25, "improvement": 0.0, "coverage": 0.01, "qd_score": 0.8, "trained_candidates": 2.0}
    assert [{key: run.data.metrics[key] for key in final} for run in found] == [final, final]


def test_sweep_ends_with_its_last_job(sweep: Path, uri: str) -> None:
    """When every job's run is finished, so is the sweep's."""
    for name in ("none-seed0", "none-seed1", "greedy-seed0", "greedy-seed1"):
        build_run(sweep / name, ENTRIES)
    mirror_once(sweep / "none-seed0", uri)
    assert everything(uri)["sweep",][1] == "FINISHED"


def test_equal_searches_of_two_sweeps_are_two_runs(sweep: Path, tmp_path: Path, uri: str) -> None:
    """A job of the same name, settings and seed in another sweep does not take the first one's place."""
    build_sweep(tmp_path / "other", ENTRIES)
    mirror_once(sweep / "none-seed0", uri)
    mirror_once(tmp_path / "other" / "none-seed0", uri)
    assert {path for path in everything(uri) if len(path) == 2} == {("sweep", "none-seed0"), ("other", "none-seed0")}


def test_shared_settings_that_may_change_make_no_second_sweep(sweep: Path, uri: str) -> None:
    """Given again with other workers, the sweep and all its searches stay the runs they were."""
    for name in ("none-seed0", "greedy-seed0"):
        mirror_once(sweep / name, uri)
    first = everything(uri)
    SweepDirectory(sweep).write(["experiment=demo", "executor.workers=4"], SweepDirectory(sweep).read()[1])
    for name in ("none-seed0", "greedy-seed0"):
        mirror_once(sweep / name, uri)
    assert everything(uri) == first


def test_sweep_takes_its_searches_along_under_a_new_name(sweep: Path, uri: str) -> None:
    """A renamed folder is the same sweep, called anew."""
    mirror_once(sweep / "none-seed0", uri)
    first = everything(uri)
    mirror_once(sweep.rename(sweep.with_name("renamed")) / "none-seed0", uri)
    second = everything(uri)
    assert set(second) == {("renamed", *path[1:]) for path in first}
    assert second["renamed", "none-seed0"][3]["tacevo.sweep"] == "renamed"


def test_read_only_sweeps_are_told_apart_by_name(sweep: Path, tmp_path: Path, uri: str) -> None:
    """Where no id can be written the names of the folders stand in for it, also the second time."""
    build_sweep(tmp_path / "other", ENTRIES[:2])
    with read_only(sweep), read_only(tmp_path / "other"):
        for folder in (sweep, tmp_path / "other", sweep):
            mirror_once(folder / "none-seed0", uri)
    assert {path for path in everything(uri) if len(path) == 2} == {("sweep", "none-seed0"), ("other", "none-seed0")}
    assert not list(tmp_path.rglob(".tracking"))


def test_search_is_not_lost_with_a_sweeps_run_that_another_machine_takes_away(sweep: Path, uri: str) -> None:
    """Without common locks a rival makes an older run, and removes ours just before our search is tagged with it."""
    from tacevo.tracking.client import PARENT_TAG, find_or_create_experiment, open_store
    from tacevo.tracking.sweeps import SWEEP_KEY_TAG, membership, nest

    member = membership(sweep / "none-seed0")
    assert member is not None
    client = open_store(uri)
    experiment = find_or_create_experiment(client, "tacevo")
    tagged: list[str] = []

    def tag(tags: Mapping[str, str]) -> None:
        if not tagged:
            client.create_run(experiment, start_time=1, tags={SWEEP_KEY_TAG: member.key})
            client.delete_run(tags[PARENT_TAG])
        tagged.append(tags[PARENT_TAG])

    nest(client, experiment, member, tag)
    assert client.get_run(tagged[-1]).info.lifecycle_stage == "active"


def test_seeds_that_were_added_meanwhile_keep_the_sweep_going(sweep: Path, uri: str) -> None:
    """The last of the jobs that a search knew of is not the last that there are now."""
    from tacevo.tracking.client import find_or_create_experiment, open_store
    from tacevo.tracking.sweeps import join_sweep, leave_sweep, membership

    directory = SweepDirectory(sweep)
    overrides, jobs = directory.read()
    directory.write(overrides, jobs[:1])
    member = membership(sweep / jobs[0].name)
    assert member is not None
    client = open_store(uri)
    experiment = find_or_create_experiment(client, "tacevo")
    join_sweep(client, experiment, member)
    directory.write(overrides, jobs)
    leave_sweep(client, experiment, member)
    assert everything(uri)["sweep",][1] == "RUNNING"
    directory.write(overrides, jobs[:1])
    leave_sweep(client, experiment, member)
    assert everything(uri)["sweep",][1] == "FINISHED"


def test_run_beside_the_jobs_of_a_sweep_is_none_of_them(sweep: Path, uri: str) -> None:
    """Only what sweep.json names is nested."""
    build_run(sweep / "trial", ENTRIES[:2])
    mirror_once(sweep / "trial", uri)
    assert set(everything(uri)) == {("trial",), ("trial", "g00s00")}


def test_jobs_that_begin_at_once_make_one_sweep(sweep: Path, uri: str) -> None:
    """However many look for the sweep's run in one moment, and find none, one is made."""
    from tacevo.tracking.client import PARENT_TAG, find_or_create_experiment, open_store
    from tacevo.tracking.sweeps import join_sweep, membership

    member = membership(sweep / "none-seed0")
    assert member is not None
    experiment = find_or_create_experiment(open_store(uri), "tacevo")
    barrier = Barrier(4)

    def join(_: int) -> str:
        client = open_store(uri)
        barrier.wait()
        return join_sweep(client, experiment, member)[PARENT_TAG]

    with ThreadPoolExecutor(4) as pool:
        assert len(set(pool.map(join, range(4)))) == 1
    assert set(everything(uri)) == {("sweep",)}


def test_run_that_was_made_twice_becomes_one(sweep: Path, uri: str) -> None:
    """Two machines made the sweep's run at once: the oldest stays, with the searches of both."""
    from mlflow import MlflowClient

    from tacevo.tracking.sweeps import SWEEP_KEY_TAG, membership

    for name in ("none-seed0", "greedy-seed0"):
        mirror_once(sweep / name, uri)
    whole = everything(uri)
    client, member = MlflowClient(uri), membership(sweep / "none-seed0")
    assert member is not None
    (old,) = client.search_runs(["1"], f"tags.`{SWEEP_KEY_TAG}` = '{member.key}'")
    second = client.create_run("1", run_name="sweep", tags={SWEEP_KEY_TAG: member.key})
    (moved,) = client.search_runs(["1"], "tags.`tacevo.arm` = 'greedy'")
    client.set_tag(moved.info.run_id, "mlflow.parentRunId", second.info.run_id)
    mirror_once(sweep / "none-seed0", uri)
    assert everything(uri) == whole
    assert client.get_run(second.info.run_id).info.lifecycle_stage == "deleted"
    assert client.get_run(old.info.run_id).info.lifecycle_stage == "active"


def test_candidate_that_was_made_twice_becomes_one(sweep: Path, uri: str) -> None:
    """A second run of a candidate goes, whether it was finished or not."""
    from mlflow import MlflowClient

    mirror_once(sweep / "none-seed0", uri)
    whole = everything(uri)
    client = MlflowClient(uri)
    (one,) = client.search_runs(["1"], "tags.`tacevo.candidate` = 'g00s00'")
    tags = {key: one.data.tags[key] for key in ("tacevo.candidate", "mlflow.parentRunId")}
    for status in ("RUNNING", "FINISHED"):
        client.set_terminated(client.create_run("1", run_name="g00s00", tags=tags).info.run_id, status)
    mirror_once(sweep / "none-seed0", uri)
    assert everything(uri) == whole


def test_password_of_a_sweep_is_not_shown(sweep: Path, uri: str) -> None:
    """What all jobs share may hold an address."""
    jobs = SweepDirectory(sweep).read()[1]
    SweepDirectory(sweep).write(["tracking.uri=postgresql://user:s3cret@host/db"], jobs)
    mirror_once(sweep / "none-seed0", uri)
    assert everything(uri)["sweep",][2] == {"overrides": "tracking.uri=postgresql://***@host/db"}
    assert "s3cret" not in json.dumps(list(everything(uri).values()))


def test_totals_adds_up_what_generations_say() -> None:
    """Improvement on generation 0, mean trainable share from generation 1 on, evaluations and costs so far."""
    second = replace(GENERATION, generation=1, candidates=4, trained=1, repaired=2, best=0.125)
    totals = Totals().after(GENERATION, Spending()).after(second, Spending(answers=1, input_tokens=5, usd=0.5))
    third = replace(second, generation=2, trained=3, repaired=0)
    totals = totals.after(third, Spending(answers=2, input_tokens=7, usd=0.25))
    measures = {measure.key: measure for measure in total_measures(totals, third)}
    assert {measure.step for measure in measures.values()} == {2}
    assert {key: measure.value for key, measure in measures.items()} == {
        "trained_candidates": 8.0,
        "improvement": 0.5,
        "trainable_rate": 0.5,
        "total_answers": 3.0,
        "total_input_tokens": 12.0,
        "total_output_tokens": 0.0,
        "total_usd": 0.75,
    }


def test_totals_leaves_out_what_does_not_apply_yet() -> None:
    """Before anything is trained there is no improvement; generation 0 has no share of trainable answers."""
    nothing = replace(SECOND_GENERATION, generation=0, candidates=1, best=None)
    assert total_measures(Totals().after(nothing, Spending()), nothing) == (
        Measure(key="trained_candidates", value=0.0, step=0),
    )
