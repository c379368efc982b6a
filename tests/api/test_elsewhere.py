"""A run gives the same answers from every directory: its stores and its data are looked up from the run as well."""

import json
import os
import shutil
from pathlib import Path

import pytest
from bundles import members_of, resealed
from commands import publish
from smallest import DRAWN, PUBLISHED_SIZES, SIMULATED, SMALLEST, UNTRACKED

from tacevo.api.actions import study
from tacevo.api.opening import open_run
from tacevo.bundles.open import opened
from tacevo.cli.app import main
from tacevo.errors import DataError, RunError
from tacevo.results.settings import found_data, settings_of
from tacevo.storage.canonical import readable
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


@pytest.mark.room("figures", "Pareto")
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
        assert lost.studies[0].reestimates is not None
    assert len(open_run(sibling / "run", store="moved").studies[0].reestimates) > 0


def test_run_moved_with_its_stores_is_found_above(sibling: Path, tmp_path: Path) -> None:
    """Where `run.dir` does not tell in which directory a run was made, the directories above it are looked through."""
    (tmp_path / "else" / "deep").mkdir(parents=True)
    (sibling / "cache").rename(tmp_path / "else" / "cache")
    (sibling / "run").rename(tmp_path / "else" / "deep" / "renamed")
    assert len(open_run(tmp_path / "else" / "deep" / "renamed").studies[0].reestimates) > 0


def test_directories_of_others_are_not_looked_through(
    sibling: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Where everyone may lay a store above a run, none is looked for there or above, unless one works there."""
    shared, run = tmp_path / "else" / "shared", tmp_path / "else" / "shared" / "mine" / "renamed"
    run.parent.mkdir(parents=True)
    (sibling / "run").rename(run)
    shutil.copytree(sibling / "cache", tmp_path / "else" / "cache")
    (sibling / "cache").rename(shared / "cache")
    assert Path(open_run(run).config.store.root) == shared / "cache"
    shared.chmod(0o777)
    assert open_run(run).recorded.without_stores
    assert main(["replay", str(run), "--store", str(shared / "cache")]) == 0
    os.chdir(shared)
    assert not open_run(run).recorded.without_stores
    os.chdir(run.parent)
    shared.chmod(0o755)
    capfd.readouterr()
    assert main(["replay", str(run)]) == 0
    assert str(shared / "cache") in capfd.readouterr().err


def test_name_that_leads_up_is_not_looked_up_above_a_run(folder: Path) -> None:
    """`../images` is meant from where it was written, and not from each directory above the run."""
    described = json.loads((folder / "run" / "run.json").read_text())
    described["config"]["data"] |= {"source": "csv", "root": "../images", "target_columns": ["Fx", "Fy", "Fz"]}
    (folder / "run" / "run.json").write_text(json.dumps(described))
    (folder / "else" / "images").mkdir(parents=True)
    (folder / "else" / "deep").mkdir()
    directory = RunDirectory((folder / "run").rename(folder / "else" / "deep" / "renamed"))
    assert found_data(directory, settings_of(directory)) == "../images"
    os.chdir(folder / "else" / "deep")
    assert Path(found_data(directory, settings_of(directory)) or "").resolve() == folder / "else" / "images"


@pytest.mark.parametrize("command", ["study", pytest.param("noise", marks=pytest.mark.room("noise")), "extend"])
def test_nothing_is_written_into_stores_of_others(
    command: str, sibling: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Where the stores of a run are not found, what would write into them asks for their name."""
    (sibling / "cache").rename("moved")
    (Path("cache") / "evaluations").mkdir(parents=True)
    size = {"extend": ["search.generations=2", UNTRACKED]}.get(command, ["elites=1", "seeds=2"])
    assert main([command, str(sibling / "run"), *size]) == 2
    told = capfd.readouterr().err
    assert ("--store" if command == "extend" else "store.root=") in told
    assert [*Path("cache").iterdir()] == [Path("cache") / "evaluations"]
    if command == "noise":
        assert main([command, str(sibling / "run"), *size, "store.root=moved"]) == 0
        assert [*Path("cache").iterdir()] == [Path("cache") / "evaluations"]


def test_open_run_is_studied_with_the_stores_that_it_has(sibling: Path) -> None:
    """Those that `open` was told need not be named again."""
    (sibling / "cache").rename("moved")
    study(open_run(sibling / "run", store="moved"), elites=1, seeds=4, epochs=1, quiet=True)
    assert not Path("cache").exists()


@pytest.mark.room("figures", "Pareto")
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
        assert run.studies


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


@pytest.mark.room("noise", "figures", "data check", "export")
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


@pytest.mark.room("export")
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


@pytest.mark.parametrize("above", ["{trap}", "../trap"])
def test_data_of_a_bundle_are_looked_up_beside_it_by_their_name_alone(above: str, bundle: Path, place: Path) -> None:
    """Its directory and those above it may hold the data; other paths that its author wrote into it lead nowhere."""
    trap, near = place / "trap", place / "near" / "deep"
    for folder in (trap / "images", near, place / "near" / "images", place / "work"):
        folder.mkdir(parents=True)
    os.chdir(place / "work")
    directory = forged(bundle, near / "one.zip", root=f"{above.format(trap=trap)}/images")
    config = settings_of(directory)
    found = found_data(directory, config)
    assert found is not None
    assert Path(found) == place / "near" / "images"
    Path(found).rmdir()
    assert found_data(directory, config) == "images"


def test_stores_that_a_bundle_names_are_not_looked_up(bundle: Path, place: Path) -> None:
    """It has stores of its own: a directory of this machine that has its trainings is not taken for them."""
    shutil.copytree(bundle.parent / "cache", place / "near" / "stores")
    directory = forged(bundle, place / "near" / "one.zip", root="images", stores="stores")
    assert settings_of(directory).store.root == "stores"


@pytest.mark.room("simulator")
def test_place_of_data_that_are_made_is_not_looked_up(place: Path) -> None:
    """Simulated images have none; a bundle that names one all the same is read without it."""
    tiny = ["search.generations=0", "search.initial=1", "run.dir=run"]
    assert main(["search", *SIMULATED, *DRAWN, UNTRACKED, *tiny]) == 0
    publish("run", "-o", "run.zip")
    (place / "images").mkdir()
    directory = forged(place / "run.zip", place / "near" / "one.zip", root="images", source="simulated")
    (place / "beside").mkdir()
    os.chdir(place / "beside")
    assert found_data(directory, settings_of(directory)) == "images"
    assert main(["replay", str(place / "near" / "one.zip"), "--retrain", "1", "--draw", "1"]) == 0


def forged(bundle: Path, target: Path, *, root: str, stores: str = "cache", source: str = "csv") -> RunDirectory:
    """Write the bundle of a run whose data set and stores lie elsewhere, as it says; return the run's directory."""
    members = members_of(bundle)
    described = json.loads(members["run/run.json"])
    described["config"]["data"] |= {"source": source, "root": root, "target_columns": ["Fx", "Fy", "Fz"]}
    described["config"]["store"]["root"] = stores
    target.parent.mkdir(parents=True, exist_ok=True)
    resealed({**members, "run/run.json": readable(described).encode()}, target)
    return RunDirectory(opened(target).folder)


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
    publish(str(recorded), "-o", str(bundle))
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
