"""A run's studies stand in MLflow below its search, with every score and the verdicts; each once, after any kill."""

import csv
import json
from pathlib import Path
from typing import Any

import pytest
from mirrored import everything, mirror_once
from refusals import refused
from waiting import eventually

import tacevo
from tacevo.cli.app import main
from tacevo.errors import RunError
from tacevo.results.study_directory import studies_of
from tacevo.tracking.track import track


def study_of(run: Path) -> tuple[tacevo.Run, Any]:
    """Open a run and its study."""
    opened = tacevo.open(run)
    assert isinstance(opened, tacevo.Run)
    return opened, opened.studies[0]


def nested(uri: str) -> dict[str, Any]:
    """Return what MLflow says of the studies, by name."""
    from mlflow import MlflowClient

    is_begun = MlflowClient(uri).get_experiment_by_name("tacevo") is not None
    return {path[-1]: said for path, said in everything(uri).items() if "tacevo.study" in said[3]} if is_begun else {}


def test_study_is_a_nested_run_with_scores_and_verdicts(run: Path, uri: str, tmp_path: Path) -> None:
    """Each metric by network, a step a seed; design and verdicts as params; the table as CSV and Markdown."""
    from mlflow import MlflowClient

    mirror_once(run, uri)
    opened, study = study_of(run)
    ((name, said),) = nested(uri).items()
    _, status, params, tags, histories, files = said
    assert (name, status, tags["tacevo.line"]) == (study.name, "FINISHED", study.digest)
    assert files == ["outcome.md", "verdicts.csv", "verdicts.md"]
    for network, rows in study.scores.groupby("network"):
        assert histories[f"mse/{network}"] == list(zip(rows.seed, rows.mse, strict=True))
        assert histories[f"validation_loss/{network}"] == list(zip(rows.seed, rows.validation_loss, strict=True))
    (verdict,) = study.verdicts.itertuples()
    assert histories["p_holm/variant 1"] == [(0, verdict.p_holm)]
    assert histories["median/baseline"] == [(0, pytest.approx(verdict.baseline_median))]
    expected = {"seeds": "4", "recipe.epochs": "1", "network.baseline": "g00s00", "digest": opened.digest}
    assert params.items() >= {**expected, "verdict.variant 1": verdict.verdict}.items()
    client = MlflowClient(uri)
    (stands,) = (one for one in client.search_runs(["1"]) if one.info.run_name == name)
    table = Path(client.download_artifacts(stands.info.run_id, "verdicts.csv", str(tmp_path)))
    assert list(csv.DictReader(table.read_text().splitlines()))[1]["verdict"] == verdict.verdict


@pytest.mark.slow
def test_search_has_the_median_of_its_archive_by_generation(run: Path, uri: str) -> None:
    """As the table of generations has it; where the stores are elsewhere it is absent, and all else is there."""
    mirror_once(run, uri)
    expected = study_of(run)[0].tables["generations"].frame
    assert everything(uri)["run",][4]["archive_median"] == list(enumerate(expected["archive median"]))


def test_studies_are_written_once_and_after_a_kill(run: Path, uri: str) -> None:
    """Mirrored twice, it says the same; one that a killed mirror left is written again."""
    from mlflow import MlflowClient

    mirror_once(run, uri)
    whole = everything(uri)
    mirror_once(run, uri)
    assert everything(uri) == whole
    client = MlflowClient(uri)
    (stands,) = (one for one in client.search_runs(["1"]) if "tacevo.study" in one.data.tags)
    client.update_run(stands.info.run_id, status="RUNNING")
    mirror_once(run, uri)
    assert everything(uri) == whole


@pytest.mark.slow
def test_run_that_the_user_nested_there_is_left_alone(run: Path, uri: str) -> None:
    """A run without a tag of ours, even one at work, is neither deleted nor an obstacle."""
    from mlflow import MlflowClient

    mirror_once(run, uri)
    client = MlflowClient(uri)
    (search,) = (one for one in client.search_runs(["1"]) if "tacevo.run" in one.data.tags)
    client.create_run("1", run_name="mine", tags={"mlflow.parentRunId": search.info.run_id})
    mirror_once(run, uri)
    assert everything(uri)["run", "mine"][1] == "RUNNING"


@pytest.mark.slow
def test_unfinished_study_waits_and_another_of_its_name_is_refused(run: Path, uri: str) -> None:
    """Its scores may be anything yet; and two studies of one name are never mixed."""
    (directory,) = studies_of(run)
    path = directory.path / "study.json"
    finished = path.read_text()
    path.write_text(json.dumps({**json.loads(finished), "digest": None}))
    mirror_once(run, uri)
    assert nested(uri) == {}
    path.write_text(finished)
    mirror_once(run, uri)
    path.write_text(json.dumps({**json.loads(finished), "digest": "0" * 64}))
    with refused(RunError, place="MLflow run", got=directory.path.name, remedy="delete that run"):
        mirror_once(run, uri)


def test_damaged_study_is_named(run: Path, uri: str) -> None:
    """By `tacevo track`, whose exit status says so."""
    (directory,) = studies_of(run)
    (directory.path / "study.json").write_text("{}")
    with refused(RunError, place="study.json"):
        track(run, uri, lambda done, total: None)


@pytest.mark.slow
def test_study_of_a_tracked_run_arrives_and_a_broken_store_is_a_warning(
    folder: Path, uri: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """By its own process, with equal digests; `tracking=none` writes nothing; a noise run arrives alike."""
    command = ["study", "run=run", "elites=1", "seeds=4", "epochs=1"]

    def studied(**tracking: str) -> str:
        path = Path("run/run.json")
        described = json.loads(path.read_text())
        described["config"]["tracking"] |= tracking
        path.write_text(json.dumps(described))
        assert main(command) == 0
        return capsys.readouterr().out.splitlines()[-1]

    untracked = studied(kind="none", uri=uri)
    assert not Path("run/tracking.log").exists()
    assert studied(kind="mlflow", uri="sqlite:////proc/nowhere/x.db") == untracked
    assert studied(kind="mlflow", uri=uri) == untracked
    assert main(["noise", "run=run", "elites=1", "seeds=2"]) == 0
    # a slow mirror may still be at work
    assert eventually(lambda: [said[1] for said in nested(uri).values()] == ["FINISHED"] * 2, seconds=300)
    told = nested(uri)
    assert {said[3]["mlflow.source.name"] for said in told.values()} == {"tacevo study", "tacevo noise"}
    noise = next(said for name, said in told.items() if name.startswith("noise"))
    assert [step for step, _ in noise[4]["fitness/variant 1"]] == [0, 1]
    assert noise[5] == ["noise.csv", "noise.md", "outcome.md"]
