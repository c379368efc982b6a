"""Promise: `tacevo study sweep=DIR` tests what each job found, as stated beforehand; the arms are compared by it."""

import csv
import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from bundles import Members, entries_of, members_of, resealed, with_entries
from commands import publish
from refusals import refused
from run_files import contents
from smallest import Once

import tacevo
from tacevo.bundles.format import STORE
from tacevo.choices import ChosenBy
from tacevo.cli.app import main
from tacevo.config.compose import compose_study
from tacevo.errors import ConfigError, RunError
from tacevo.results.study import load_study
from tacevo.results.sweep import load_sweep
from tacevo.results.trivial import trivial_score
from tacevo.runs.progress import Progress
from tacevo.storage.sweep_directory import Retraining, SweepDirectory
from tacevo.studies.of_sweep import study_sweep

pytestmark = pytest.mark.timeout(300)

TEST = ["study", "sweep=sweep", "seeds=2", "epochs=1", "store.root=cache"]


@pytest.fixture(scope="session")
def scored(swept: Path, once: Once) -> Path:
    """Return a directory with a copy of `swept`'s sweep, whose jobs were tested; no test may change it."""

    def fill(folder: Path) -> None:
        for name in ("sweep", "cache"):
            shutil.copytree(swept / name, folder / name)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            assert main(TEST) == 0

    return once("tested", fill)


@pytest.fixture
def folder(scored: Path, place: Path) -> Path:
    """Work in a copy of it."""
    return Path(shutil.copytree(scored, place, dirs_exist_ok=True))


def files(folder: Path) -> dict[str, bytes]:
    """Read all files of all studies."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.glob("sweep/*/studies/*/*")}


def published(folder: Path) -> Members:
    """Publish the sweep as sweep.zip; return the members."""
    publish("sweep", "--store", "cache", "-o", "sweep.zip", "--author", "A. Nyone")
    return members_of(folder / "sweep.zip")


def test_each_job_has_a_study_of_its_best_elite(folder: Path) -> None:
    """Of the baseline and one elite, with the stated seeds and epochs, which sweep.json has."""
    directory = SweepDirectory(Path("sweep"))
    stated = directory.read().terms.retraining
    assert stated is not None
    assert (stated.seeds, stated.epochs) == (2, 1)
    for job in directory.read().jobs:
        (path,) = directory.run(job).path.glob("studies/*")
        study = load_study(path)
        assert (len(study.networks), study.seeds, study.recipe.epochs) == (2, 2, 1)


@pytest.mark.slow
def test_ablations_compare_the_test_scores(folder: Path) -> None:
    """One value a job: the median of its network's scores; the metric comes first and is called primary."""
    assert main(["ablations", "sweep", "--store", "cache"]) == 0
    with (folder / "sweep" / "ablations" / "more" / "ablation_runs.csv").open(encoding="utf-8", newline="") as file:
        told = {row["run"]: float(row["test MSE"]) for row in csv.DictReader(file)}
    for job, value in told.items():
        (path,) = folder.glob(f"sweep/{job}/studies/*")
        study = load_study(path)
        best = min(study.networks, key=lambda one: one.fitness)
        assert value == pytest.approx(median(study.values(best.name, "mse")), rel=1e-8)
    text = (folder / "sweep" / "ablations" / "ablation_test_mse.md").read_text()
    assert "Primary metric: test MSE, as the sweep stated before its jobs were tested" in text


@pytest.mark.slow
def test_job_without_its_test_is_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It keeps all other values."""
    shutil.rmtree(folder / "sweep" / "none-seed1" / "studies")
    assert main(["ablations", "sweep", "--store", "cache"]) == 0
    assert "without a test score: none-seed1:" in capsys.readouterr().err
    assert "Without a test score, 1 job: none-seed1." in (folder / "sweep/ablations/ablation.md").read_text()


def test_same_command_again_trains_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nor does it change a byte."""
    before = files(folder), (folder / "sweep" / "sweep.json").read_bytes()
    assert main(TEST) == 0
    assert capsys.readouterr().out.count("(4 trainings, 4 of them recorded already)") == 3
    assert (files(folder), (folder / "sweep" / "sweep.json").read_bytes()) == before


@pytest.mark.slow
def test_jobs_are_tested_on_the_device_that_the_sweep_states(swept: Path, place: Path) -> None:
    """Only such studies count; a job's own study of these settings does, too, and no other is stated afterwards."""
    for name in ("sweep", "cache"):
        shutil.copytree(swept / name, place / name)
    assert main([*TEST, "numerics=fast"]) == 0
    stated = SweepDirectory(Path("sweep")).read().terms.retraining
    assert stated is not None
    assert stated.other_device == (("numerics", "fast"),)
    assert stated.settings.endswith(" numerics=fast")
    assert load_sweep(Path("sweep")).untested == ()
    with refused(RunError, place="terms.retraining", expected="numerics=fast"):
        study_sweep(Path("sweep"), compose_study(TEST[1:]), Progress())
    (path,) = Path("sweep/none-seed0/studies").iterdir()
    shutil.rmtree(path)
    settings = ["elites=1", "seeds=2", "epochs=1", "store.root=cache"]
    assert main(["study", "sweep/none-seed0", *settings]) == 0
    assert [one.job.name for one in load_sweep(Path("sweep")).untested] == ["none-seed0"]
    assert main(["study", "sweep/none-seed0", *settings, "numerics=fast"]) == 0
    assert load_sweep(Path("sweep")).untested == ()


class StoppedAtJob(Progress):
    """A user who stops a command before it trains for a job."""

    def say(self, text: str) -> None:
        """Stop at the first job."""
        if text.startswith("job "):
            raise KeyboardInterrupt


def test_other_settings_are_refused_once_a_job_was_tested(folder: Path) -> None:
    """Seeds and epochs cannot be chosen by what they give; before there is a score they may still be changed."""
    config = compose_study([*TEST[1:], "epochs=2"])
    with refused(RunError, place="terms.retraining", expected="seeds=2 epochs=1", got="seeds=2 epochs=2"):
        study_sweep(Path("sweep"), config, Progress())
    with refused(RunError, place="terms.retraining", expected="seeds=2 epochs=1", got="elites=2 seeds=2 epochs=1"):
        study_sweep(Path("sweep"), compose_study([*TEST[1:], "elites=2"]), Progress())
    for path in folder.glob("sweep/*/studies"):
        shutil.rmtree(path)
    with pytest.raises(KeyboardInterrupt):
        study_sweep(Path("sweep"), config, StoppedAtJob())
    stated = SweepDirectory(Path("sweep")).read().terms.retraining
    assert stated == Retraining(seeds=2, epochs=2, choose=config.choose)


def untested(folder: Path) -> str:
    """Let the sweep be one that was never tested; return the arm beside `none`."""
    directory = SweepDirectory(Path("sweep"))
    sweep = directory.read()
    directory.write(replace(sweep, terms=replace(sweep.terms, retraining=None)))
    for path in folder.glob("sweep/*/studies"):
        shutil.rmtree(path)
    (other,) = {job.arm for job in sweep.jobs} - {"none"}
    return other


def test_arms_that_cannot_be_compared_are_refused_before_anything_is_stated(folder: Path) -> None:
    """One that the sweep does not have; or the reference is left out."""
    other = untested(folder)
    for arms, expected in (("none,nothing", "arms of the sweep: none"), (other, "none among them")):
        with refused(ConfigError, place="arms", expected=expected):
            study_sweep(Path("sweep"), compose_study([*TEST[1:], f"arms={arms}"]), Progress())
    assert SweepDirectory(Path("sweep")).read().terms.retraining is None


@pytest.mark.parametrize("spoilt", ["source", "ledger", pytest.param("nothing", marks=pytest.mark.room("noise"))])
def test_study_that_a_run_refuses_states_nothing(folder: Path, spoilt: str) -> None:
    """Be it the last job whose elite was edited, whose ledger is damaged, or that has no noise run to choose by."""
    untested(folder)
    directory = SweepDirectory(Path("sweep"))
    job = directory.read().jobs[-1]
    run, place = directory.run(job).path, f"job {job.name}"
    settings = [*TEST[1:], "elites=9"]
    if spoilt == "source":
        for path in (run / "candidates").glob("*.py"):
            path.write_text("# edited")
    elif spoilt == "ledger":
        (run / "prompts.json").write_text("{}")
    else:
        settings.append("choose=reestimated")
        place = f"job {directory.read().jobs[0].name}"
    before = (folder / "sweep" / "sweep.json").read_bytes()
    with refused(RunError, place=place):
        study_sweep(Path("sweep"), compose_study(settings), Progress())
    assert (folder / "sweep" / "sweep.json").read_bytes() == before
    assert not files(folder)


@pytest.mark.slow
def test_named_arms_alone_are_tested(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As stated before the first training and kept from then on; what other arms lack is not missing."""
    other, directory = untested(folder), SweepDirectory(Path("sweep"))
    assert main([*TEST, "arms=none"]) == 0
    assert {path.parent.name for path in folder.glob("sweep/*/studies")} == {"none-seed0", "none-seed1"}
    stated = directory.read().terms.retraining
    assert stated == Retraining(seeds=2, epochs=1, choose=ChosenBy.fitness, arms=("none",))
    assert load_sweep(Path("sweep")).untested == ()
    settings: Any = {"arms": ["none"], "seeds": 2, "epochs": 1, "store.root": "cache", "quiet": True}
    opened = tacevo.open("sweep", store="cache")
    assert isinstance(opened, tacevo.Sweep)
    jobs = tacevo.study(opened, **settings).jobs
    assert jobs["test_mse"].notna().tolist() == [arm == "none" for arm in jobs["arm"]]
    assert main(["ablations", "sweep", "--store", "cache"]) == 0
    assert f"Not tested, as the sweep states: {other}." in (folder / "sweep/ablations/ablation.md").read_text()
    with refused(RunError, place="terms.retraining", expected="arms=none", got="seeds=2 epochs=1 choose=fitness"):
        study_sweep(Path("sweep"), compose_study(TEST[1:]), Progress())
    published(folder)
    capsys.readouterr()
    assert main(["replay", "sweep.zip"]) == 0


def test_arms_are_of_a_sweep() -> None:
    """Names with commas between them, or a list; a single run has none."""
    assert compose_study(["sweep=s", "arms=none,drift"]).arms == ("none", "drift")
    assert compose_study(["sweep=s", "arms=[none,'archive.niches=5']"]).arms == ("none", "archive.niches=5")
    assert compose_study(["sweep=s", "arms=none"]).arms == ("none",)
    for written in ("'archive.niches=5'", "archive.niches=5"):
        assert compose_study(["sweep=s", f"arms={written},none"]).arms == ("archive.niches=5", "none")
    stated = Retraining(seeds=2, epochs=1, choose=ChosenBy.fitness, arms=("none", "no_qd prompts=curiosity"))
    assert compose_study(["sweep=s", *shlex.split(stated.settings)]).arms == stated.arms
    with refused(ConfigError, place="arms", expected="no value without sweep="):
        compose_study(["run=r", "arms=none"])


def test_settings_are_not_stated_once_their_scores_are_there(folder: Path) -> None:
    """A study by hand that happens to be alike was not stated before it; other settings are."""
    directory = SweepDirectory(Path("sweep"))
    sweep = directory.read()
    directory.write(replace(sweep, terms=replace(sweep.terms, retraining=None)))
    with refused(RunError, place="terms.retraining", got="seeds=2 epochs=1", expected="no job was tested before"):
        study_sweep(Path("sweep"), compose_study(TEST[1:]), Progress())
    assert directory.read().terms.retraining is None


def test_unfinished_job_is_named_and_the_others_are_tested(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The status says so, and the same command tests it later."""
    shutil.rmtree(folder / "sweep" / "none-seed1")
    assert main(TEST) == 1
    assert "no study, for it is not finished: none-seed1" in capsys.readouterr().out
    for job in SweepDirectory(Path("sweep")).read().jobs:
        shutil.rmtree(folder / "sweep" / job.name, ignore_errors=True)
    assert main(TEST) == 2
    assert "expected at least one finished job" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("settings", "place_of", "got"),
    [
        ([], "run", "none"),
        (["run=a", "sweep=b"], "run", "run=a and sweep=b"),
        (["sweep="], "sweep", '""'),
        (["sweep=b", "elites=0"], "elites", "0"),
    ],
)
def test_wrong_setting_is_refused_by_its_name(settings: list[str], place_of: str, got: str) -> None:
    """A study is of a run or of a sweep's jobs."""
    with refused(ConfigError, place=place_of, got=got):
        compose_study(settings)


@pytest.mark.room("noise", "plans, pilots")
@pytest.mark.slow
def test_several_elites_that_a_noise_run_chose_are_tested(
    swept: Path, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each job has one value, of its best two by their re-estimates; a bundle replays and compares as the directory."""
    for name in ("sweep", "cache"):
        shutil.copytree(swept / name, place / name)
    assert main(["noise", "sweep=sweep", "elites=3", "seeds=2", "store.root=cache"]) == 0
    assert main([*TEST, "elites=2", "choose=reestimated"]) == 0
    assert main([*TEST, "elites=2", "choose=reestimated"]) == 0  # it continues
    assert json.loads((place / "sweep" / "sweep.json").read_text())["terms"]["retraining"]["elites"] == 2
    (tested, *_) = load_sweep(Path("sweep")).finished
    assert tested.tested is not None
    assert len(tested.tested.networks) == 2
    published(place)
    capsys.readouterr()
    assert main(["replay", "sweep.zip"]) == 0
    for source, target in (("sweep", "from-directory"), ("sweep.zip", "from-bundle")):
        assert main(["ablations", source, "-o", target, *(["--store", "cache"] if source == "sweep" else [])]) == 0
    assert contents(Path("from-directory")) == contents(Path("from-bundle"))
    with (place / "from-bundle" / "more" / "ablation_runs.csv").open(encoding="utf-8", newline="") as file:
        assert next(float(row["test loss"]) for row in csv.DictReader(file)) == pytest.approx(tested.tested.loss)
    assert main(["plan", "sweep", "sweep", "--effect", "0.5", "-o", "planned"]) in {0, 1}
    assert "test loss" in capsys.readouterr().out


@pytest.mark.slow
def test_published_sweep_has_its_terms_and_its_tests(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The bundle gives the tables that the directory gives; its replay compares every score, and says with what."""
    assert {entry["kind"] for entry in entries_of(published(folder))}.isdisjoint({"arrays"})
    assert main(["replay", "sweep.zip"]) == 0
    assert "the bundle of a sweep holds no test predictions: scores are those of" in capsys.readouterr().out
    for source, target in (("sweep", "from-directory"), ("sweep.zip", "from-bundle")):
        store = ["--store", "cache"] if source == "sweep" else []
        assert main(["ablations", source, "-o", target, *store]) == 0
    one, other = (contents(Path(name)) for name in ("from-directory", "from-bundle"))
    assert one == other
    assert {name for name in one if name.endswith(".md") and "/" not in name} == {
        *("index.md", "ablation.md", "ablation_test_mse.md")  # the overview, and the primary metric
    }
    assert main(["replay", "sweep.zip/none-seed1"]) == 0
    assert "none-seed1: digest" not in (told := capsys.readouterr().out)
    assert "every score is as recorded" in told
    assert "the bundle of a sweep holds no test predictions" in told


@pytest.mark.slow
def test_import_of_a_published_sweeps_store_leaves_no_half_of_a_training(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A training without its test predictions would be recalled by the next study, and end it."""
    (folder / STORE).write_bytes(published(folder)[STORE])
    assert main(["cache", "import", STORE, "--store", "imported"]) == 0
    assert "passed over: files of candidates, and full trainings" in capsys.readouterr().out
    kinds = {path.name for path in (folder / "imported").iterdir()}
    assert "evaluations" in kinds
    assert kinds.isdisjoint({"studies", "arrays", "candidates"})


@pytest.mark.slow
def test_predictions_of_an_older_published_sweep_are_computed_with(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Releases before this one packed them; where they are, nothing is taken as recorded."""
    members = published(folder)
    kept = [json.loads(path.read_bytes()) for path in (folder / "cache" / "arrays").rglob("*.json")]
    entries = [*entries_of(members), *({name: one[name] for name in ("kind", "request", "answer")} for one in kept)]
    whole = resealed(with_entries(members, entries), folder / "whole.zip")
    capsys.readouterr()
    assert main(["replay", str(whole)]) == 0
    assert "no test predictions" not in capsys.readouterr().out
    training = next(entry for entry in entries if entry["kind"] == "studies")
    training["answer"]["full"]["metrics"]["mse"] /= 2
    assert main(["replay", str(resealed(with_entries(members, entries), folder / "x.zip"))]) == 1
    assert "by the test predictions" in capsys.readouterr().err


@pytest.mark.slow
def test_score_that_no_training_gave_is_found_in_a_published_sweep(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without test predictions, the recorded trainings still say what each score is."""
    members = published(folder)
    entries = entries_of(members)
    training = next(entry for entry in entries if entry["kind"] == "studies")
    training["answer"]["full"]["metrics"]["mse"] /= 2
    assert main(["replay", str(resealed(with_entries(members, entries), folder / "x.zip"))]) == 1
    assert "metrics.mse" in capsys.readouterr().err


@pytest.mark.room("noise")
@pytest.mark.slow
def test_every_job_has_a_noise_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of all its elites, with the seeds that were asked for."""
    assert main(["noise", "sweep=sweep", "seeds=2", "store.root=cache"]) == 0
    assert "tacevo ablations sweep" in capsys.readouterr().out
    runs = [path.parent for path in folder.glob("sweep/*/archive.json")]
    assert len(runs) > 1
    for run in runs:
        (lines,) = run.glob("studies/noise*/scores.jsonl")
        rows = [json.loads(line) for line in lines.read_text().splitlines()[1:]]
        elites = {elite["id"] for elite in json.loads((run / "archive.json").read_text())["elites"]}
        assert elites <= {row["id"] for row in rows}
        assert {row["seed"] for row in rows} == {0, 1}


@pytest.mark.room("noise")
def test_noise_run_of_a_run_and_a_sweep_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One of both is meant."""
    assert main(["noise", "run=sweep/none-seed0", "sweep=sweep"]) == 2
    assert "got both run=sweep/none-seed0 and sweep=sweep" in capsys.readouterr().err


@pytest.mark.slow
def test_trivial_predictor_stands_beside_the_arms(folder: Path) -> None:
    """With its test score, and nothing else: by the labels' variance, which the scores of a study tell."""
    assert main(["ablations", "sweep", "--store", "cache"]) == 0
    for name in ("ablation", "ablation_test_mse", "more/ablation_best_fitness"):
        with (folder / "sweep" / "ablations" / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            rows = [list(row.values()) for row in csv.DictReader(file) if row["arm"] == "trivial"]
        if name == "more/ablation_best_fitness":
            assert rows == []
            continue
        (path,) = folder.glob("sweep/none-seed0/studies/*")
        score = pytest.approx(trivial_score(load_study(path)), rel=1e-6)
        told = [float(cell) for cell in rows[0][1:] if cell]
        assert told == [score] * (2 if name == "ablation" else 1)  # of a regression the loss is the MSE, too
