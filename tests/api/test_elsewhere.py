"""A run gives the same answers from every directory: its stores and its data are looked up from the run as well."""

import json
import shutil
from pathlib import Path

import pytest
from smallest import PUBLISHED_SIZES, SMALLEST, UNTRACKED

from tacevo.api.opening import open_run
from tacevo.cli.app import main
from tacevo.errors import DataError, RunError
from tacevo.storage.run_directory import RunDirectory


@pytest.fixture
def sibling(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a directory beside that of a run with a study; return the directory of the run."""
    beside = folder / "beside"
    beside.mkdir()
    own = folder / "own"
    own.mkdir()
    for name in ("run", "cache"):
        (folder / name).rename(own / name)
    monkeypatch.chdir(beside)
    return own


def test_answers_are_equal_from_every_directory(sibling: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Re-estimates, tables and figures, which the stores hold, are those of the run's own directory."""
    there = open_run(sibling / "run")
    answers = there.pareto().to_csv(), list(there.tables), list(there.figures), len(there.studies[0].reestimates)
    assert "re-estimated" in answers[0]
    assert there.replay(quiet=True) == there.digest
    monkeypatch.chdir(sibling)
    here = open_run("run")
    assert (here.pareto().to_csv(), list(here.tables), list(here.figures), len(here.studies[0].reestimates)) == answers
    assert here.config.store.root == "cache"


def test_stores_of_others_are_not_taken_for_the_run_s(sibling: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A store of the same name in the working directory, or above the run, is another one unless it has the run."""
    for other in (Path("cache"), sibling / "run" / "cache"):
        (other / "evaluations").mkdir(parents=True)
    assert Path(open_run(sibling / "run").config.store.root) == sibling / "cache"
    (sibling / "cache").rename("moved")
    lost = open_run(sibling / "run")
    assert lost.config.store.root == "cache"  # the user's own directory, and never one that lies above the run
    with pytest.raises(RunError, match="store=DIR"):
        lost.pareto()
    assert "re-estimated" in set(open_run(sibling / "run", store="moved").pareto().estimate)


def test_run_moved_with_its_stores_is_found_above(sibling: Path, tmp_path: Path) -> None:
    """Where `run.dir` does not tell in which directory a run was made, the directories above it are looked through."""
    (tmp_path / "else" / "deep").mkdir(parents=True)
    (sibling / "cache").rename(tmp_path / "else" / "cache")
    (sibling / "run").rename(tmp_path / "else" / "deep" / "renamed")
    assert "re-estimated" in set(open_run(tmp_path / "else" / "deep" / "renamed").pareto().estimate)


def test_missing_stores_are_told_by_every_object_that_needs_them(sibling: Path) -> None:
    """What would be other numbers is an error or left out; run, study, tables and figures say that stores are missing.

    What stands in the records alone is there all the same.
    """
    shutil.rmtree(sibling / "cache")
    run = open_run(sibling / "run")
    (study,) = run.studies
    for shown in (run, run.tables, run.figures, study.tables, study.figures):
        assert "its stores are not in cache" in repr(shown)
    assert "its stores are not in cache" in run._repr_html_()
    assert "no re-estimates" in repr(study)
    with pytest.raises(RunError, match="expected the trainings of the study"):
        run.pareto()
    assert "re-estimated" not in set(run.pareto(["parameters", "flops"]).estimate)  # which needs no re-estimate
    with pytest.raises(RunError, match="expected the trainings of the study"):
        assert study.reestimates is not None
    assert not {"pareto", "improvement"} & set(run.tables)
    assert "pareto" not in run.figures
    assert any("improvement" in reason for reason in run.left_out)
    assert len(study.scores) == 8


def test_directory_that_is_left_is_an_error(sibling: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that was opened by a relative path has studies after `os.chdir`, or says that it is not there."""
    monkeypatch.chdir(sibling)
    run = open_run("run")
    monkeypatch.chdir("/")
    with pytest.raises(RunError, match="open the run again"):
        run.pareto()


@pytest.fixture
def recorded(place: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work beside the directory of a run of recorded images; both its stores and its data have relative names."""
    own = place / "own"
    own.mkdir()
    monkeypatch.chdir(own)
    assert main(["data", "simulate", "task=force", "n=40", "data.image_size=32", "out=images"]) == 0
    settings = ["data=csv", "data.root=images", "data.target_columns=[Fx,Fy,Fz]", "data.image_size=32"]
    size = [word for word in SMALLEST if not word.startswith("data.")]
    assert main(["search", *size, UNTRACKED, *PUBLISHED_SIZES, *settings]) == 0
    (run,) = (own / "runs").iterdir()
    beside = place / "beside"
    beside.mkdir()
    monkeypatch.chdir(beside)
    return run


@pytest.mark.slow
def test_commands_find_data_from_the_run(recorded: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A study, a noise run, retraining, an export and an extension from elsewhere train on the run's own images."""
    run = str(recorded)
    assert main(["study", run, "elites=1", "seeds=2", "epochs=1"]) == 0
    assert main(["study", run, "elites=1", "seeds=2", "epochs=1", "data.split_seed=3"]) == 0
    assert main(["noise", run, "seeds=2", "elites=1"]) == 0
    assert main(["replay", run, "--retrain", "1"]) == 0
    assert main(["extend", run, "search.generations=2", UNTRACKED]) == 0
    open_run(run).figures["samples"]()
    assert not Path("cache/studies").exists()


@pytest.mark.slow
def test_export_takes_the_place_of_the_data(recorded: Path) -> None:
    """The data set may have moved; another data set, or another setting of data, is refused."""
    images = recorded.parents[1] / "images"
    images.rename("moved")
    run = open_run(recorded)
    with pytest.raises(DataError, match=r"data\.root"):
        run.export("g00s00", "lost", like="search", quiet=True)
    assert main(["export", str(recorded), "g00s00", "-o", "found", "like=search", "data.root=moved"]) == 0
    assert main(["export", str(recorded), "g00s00", "-o", "other", "data.split_seed=1"]) == 2
    labels = Path("moved") / "labels.csv"
    labels.write_text(labels.read_text().replace("-", ""))
    with pytest.raises(DataError, match="fingerprint"):
        run.export("g00s00", "changed", "data.root=moved", like="search", quiet=True)


def test_directory_of_a_bundle_is_looked_through_for_its_data(bundle: Path) -> None:
    """A bundle has a file of its own, whose directory and those above it may hold the data."""
    run = open_run(bundle)
    assert isinstance(run.recorded.directory, RunDirectory)
    assert run.recorded.with_data == run.config


def test_missing_data_is_told_before_anything_is_replayed(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Training again needs them, and a replay of a long run takes its time before."""
    described = json.loads((folder / "run" / "run.json").read_text())
    described["config"]["data"] |= {"source": "csv", "root": "images", "target_columns": ["Fx", "Fy", "Fz"]}
    (folder / "run" / "run.json").write_text(json.dumps(described))
    assert main(["replay", "run", "--retrain", "1"]) == 2
    told = capfd.readouterr().err
    assert "data.root" in told
    assert "replayed" not in told


@pytest.mark.slow
def test_bundle_without_images_says_that_it_holds_none(
    recorded: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Beside the data it is replayed with its trainings; anywhere it is replayed without them."""
    bundle = recorded.parents[1] / "one.zip"
    assert main(["publish", str(recorded), "-o", str(bundle)]) == 0
    assert main(["replay", str(bundle), "--retrain", "1"]) == 0
    away = recorded.parents[2] / "away"
    away.mkdir()
    moved = bundle.rename(away / "one.zip")
    capfd.readouterr()
    assert main(["replay", str(moved), "--retrain", "1"]) == 2
    told = capfd.readouterr().err
    assert "a bundle holds none" in told
    assert "replayed" not in told
    assert main(["replay", str(moved)]) == 0
