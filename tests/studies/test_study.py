"""Promise: a study gives the same bytes however it is computed, and a replay compares all of it."""

import json
import re
import shutil
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from refusals import refused
from rewritten import rewrite_study
from smallest import DRAWN, SIMULATED, SMALLEST, UNTRACKED, Once
from sweeps import Heard
from waiting import eventually

from tacevo.choices import Device, Numerics, Precision
from tacevo.cli.app import main
from tacevo.errors import RunError
from tacevo.records import Gpu, to_json
from tacevo.results.run import read_run
from tacevo.results.study import load_study
from tacevo.results.study_directory import StudyDirectory, studies_of
from tacevo.results.study_lines import SCHEMA, ScoreLine
from tacevo.runs.progress import Progress
from tacevo.storage.canonical import value_at
from tacevo.storage.store import Store, check_entry
from tacevo.studies.study import _train, replay_study

pytestmark = pytest.mark.timeout(300)

#: A real search, as small as one can be that finds a network beside the baseline.
TINY = [*SMALLEST, UNTRACKED, "search.generations=0", "search.initial=2", "run.dir=run"]
STUDY = ["run=run", "elites=1", "seeds=2", "epochs=2"]


@pytest.fixture(scope="session")
def studied(published: Path, once: Once) -> Path:
    """Return a directory with a finished tiny search and its study; no test may change it."""

    def study(folder: Path) -> None:
        shutil.copytree(published / "cache", folder / "cache", ignore=shutil.ignore_patterns("studies"))
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            assert main(["search", *TINY]) == 0
            assert main(["study", *STUDY]) == 0

    return once("studied", study)


@pytest.fixture
def folder(studied: Path, place: Path) -> Path:
    """Work in a copy of the finished search and study."""
    shutil.copytree(studied, place, dirs_exist_ok=True)
    return place


def files(folder: Path) -> dict[str, bytes]:
    """Read the files of the only study."""
    return {path.name: path.read_bytes() for path in folder.glob("run/studies/*/*")}


def only(folder: Path) -> Path:
    """Return the directory of the only study."""
    (path,) = folder.glob("run/studies/*")
    return path


def forget(folder: Path) -> None:
    """Remove the study and its trainings."""
    shutil.rmtree(folder / "run" / "studies")
    shutil.rmtree(folder / "cache" / "studies")


def trainings(folder: Path) -> int:
    """Count the full trainings in the store."""
    return len(list(folder.glob("cache/studies/*/*.json")))


def test_study_is_about_the_baseline_and_the_best_elite(studied: Path) -> None:
    """The analysis ranks the archive as the study chose; each network is tested with each seed."""
    study, run = load_study(only(studied)), read_run(studied / "run")
    assert [network.id for network in study.networks] == [run.baseline.id, *(best.id for best in run.best(1))]
    assert (study.run, study.fingerprint) == (run.digest, run.facts.fingerprint)
    assert [(score.network, score.seed) for score in study.scores] == [
        (name, seed) for name in ("baseline", "variant 1") for seed in (0, 1)
    ]
    assert study.recipe.epochs == 2
    assert study.recipe.learning_rate == run.config.training.learning_rate
    assert {"mse", "mae", "rmse", "r2", "mse_Fx", "recorded_mae_Fz"} <= study.scores[0].metrics.keys()
    assert len(set(study.values("baseline", "mse"))) == 2


def test_networks_are_paired_by_seed(studied: Path) -> None:
    """Each seed of the study is one training seed, the same for both networks."""
    entries = list(Store(studied / "cache", "studies").entries())
    seeds = {(value_at(entry.request, ("source",)), value_at(entry.request, ("seed",))) for entry in entries}
    assert len(entries) == 4
    assert len({seed for _, seed in seeds}) == len({source for source, _ in seeds}) == 2


def test_description_can_be_read_with_cat(studied: Path) -> None:
    """What was studied, by which versions, on which machine, in which units; no time stamp anywhere."""
    texts = {name: data.decode() for name, data in files(studied).items()}
    assert texts.keys() == {"study.json", "scores.jsonl"}
    described = json.loads(texts["study.json"])
    assert described["schema"] == SCHEMA
    assert described["digest"] == json.loads(texts["scores.jsonl"].splitlines()[-1])["hash"]
    assert described["units"] == ["N", "N", "N"]
    assert len(described["scale"]) == 3
    assert {"torch", "numpy"} <= described["versions"].keys()
    assert not re.search(r"\d{4}-\d\d-\d\d|\d\d:\d\d", "".join(texts.values()))


def test_same_command_again_trains_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It reads the store, says so, and ends with the digest; not a byte changes."""
    before, entries = files(folder), {path: path.stat().st_mtime_ns for path in folder.glob("cache/studies/*/*")}
    assert main(["study", *STUDY]) == 0
    output = capsys.readouterr()
    assert "(4 of 4 trainings recorded already)" in output.err
    assert "are done" not in output.err
    assert "(4 trainings, 4 of them recorded already)" in output.out
    digest = json.loads(before["study.json"])["digest"]
    assert output.out.splitlines()[-1] == f"digest: {digest}"
    assert files(folder) == before
    assert {path: path.stat().st_mtime_ns for path in folder.glob("cache/studies/*/*")} == entries


@pytest.mark.slow
def test_fewer_elites_than_asked_for_are_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where the archive has no more, it is the study of those there are, and that is said."""
    study, before = only(folder), files(folder)
    assert main(["study", "run=run", "elites=9", *STUDY[2:]]) == 0
    assert "the archive has 1 elite with a source of its own, fewer than elites=9" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in study.iterdir()} == before


def test_too_few_seeds_are_told_before_anything_is_trained(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two seeds can be compared at alpha 0.5 alone."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tacevo.studies.study._train", stop)
    assert main(["study", *STUDY]) == 130
    said = capsys.readouterr().err
    warning = (
        "no comparison with the baseline will be possible: at alpha 0.05 no outcome of seeds=2 is significant; it "
        "takes seeds=4"
    )
    assert warning in said
    assert main(["study", *STUDY, "alpha=0.5"]) == 130
    assert "no comparison" not in capsys.readouterr().err


@pytest.mark.slow
def test_progress_counts_on_from_what_was_recorded(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of another seed, two trainings are new; the four of before are not told as if they were trained now."""
    told: list[tuple[object, ...]] = []
    monkeypatch.setattr(Progress, "advance", lambda _, *count: told.append(count))
    assert main(["study", *STUDY[:2], "seeds=3", STUDY[3]]) == 0
    assert told == [("trainings", done, 6) for done in (4, 5, 6)]
    assert "(6 trainings, 4 of them recorded already)" in capsys.readouterr().out


def test_terms_are_stated_in_the_study_and_change_no_training(folder: Path) -> None:
    """Another margin is another study of the same trainings: nothing is trained, and both stand side by side."""
    (first,) = studies_of(folder / "run")
    before = {path: path.stat().st_mtime_ns for path in folder.glob("cache/studies/*/*")}
    assert (
        main(["study", *STUDY, "alpha=0.01", "margins.regression.value=0.2", "margins.regression.kind=absolute"]) == 0
    )
    (second,) = (one for one in studies_of(folder / "run") if one.path != first.path)
    stated = {"alpha": 0.01, "margin": {"value": 0.2, "kind": "absolute"}}
    assert to_json(second.read().terms) == to_json(second.read_scores().header.terms) == stated
    assert to_json(first.read().terms) == {"alpha": 0.05, "margin": {"value": 0.1, "kind": "relative"}}
    assert main(["study", *STUDY, "margins.classification.value=0.5"]) == 0  # of another kind of task: not a term
    assert len(studies_of(folder / "run")) == 2
    lines = [[row.evaluation for row in directory.read_scores().rows] for directory in (first, second)]
    assert lines[0] == lines[1]
    assert {path: path.stat().st_mtime_ns for path in folder.glob("cache/studies/*/*")} == before
    assert main(["replay", "run"]) == 0


@pytest.mark.slow
def test_two_processes_divide_a_study_and_give_the_bytes_of_one(folder: Path) -> None:
    """At the same time, on the same run and store."""
    before = files(folder)
    forget(folder)
    command = [sys.executable, "-m", "tacevo.cli.app", "study", *STUDY, "executor.workers=1"]
    processes = [subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) for _ in range(2)]
    for process in processes:
        _, errors = process.communicate(timeout=240)
        assert process.returncode == 0, errors
    assert files(folder) == before
    assert trainings(folder) == 4


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_stopped_study_goes_on_to_the_same_bytes(number: signal.Signals, folder: Path) -> None:
    """Stopped after its first training: that one is kept, and the same command does the rest."""
    before = files(folder)
    forget(folder)
    command = [sys.executable, "-m", "tacevo.cli.app", "study", *STUDY, "executor.workers=1"]
    study = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert eventually(lambda: trainings(folder) > 0, seconds=120)
    study.send_signal(number)
    _, errors = study.communicate(timeout=60)
    assert "Traceback" not in errors
    assert study.returncode == (130 if number == signal.SIGINT else -signal.SIGKILL)
    assert ("what was computed is kept, and the same command continues" in errors) == (number == signal.SIGINT)
    assert 1 <= trainings(folder) < 4
    assert json.loads(files(folder)["study.json"])["digest"] is None
    assert main(["replay", "run"]) == 0
    assert main(["study", *STUDY]) == 0
    assert files(folder) == before


def test_replay_compares_every_score_without_training(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the store alone, without the data set; a study that is only begun is passed over."""
    shutil.rmtree(folder / "cache" / "data")
    (folder / "run" / "studies" / "begun").mkdir()
    (finished,) = folder.glob("run/studies/elites*/study.json")
    begun = {**json.loads(finished.read_text()), "digest": None}
    (folder / "run" / "studies" / "begun" / "study.json").write_text(json.dumps(begun))
    assert main(["replay", "run"]) == 0
    output = capsys.readouterr()
    digest = json.loads(next(folder.glob("run/studies/elites*/study.json")).read_text())["digest"]
    assert re.search(rf"study elites1-\S+: every score is as recorded, digest {digest}", output.out)
    assert "study begun is not finished and is passed over" in output.err


@pytest.mark.parametrize("captured", [False, True])
def test_study_of_an_earlier_release_on_a_gpu_replays(captured: bool, folder: Path) -> None:
    """Its rules ran every step eagerly, and said nothing of it; that steps were captured cannot be true of them."""
    study = StudyDirectory(only(folder))
    gpu = Gpu(model="NVIDIA H200", precision=Precision.float32, memory_mib=8192, captured=captured)
    told = (("numerics", "fast"), ("training.device", "cuda"), ("training.gpu", gpu.model))
    recipe = replace(study.read().recipe, gpu=gpu)
    changes = {"rules": 6, "recipe": recipe, "numerics": Numerics.fast, "device": Device.cuda, "other_device": told}
    rewrite_study(study, folder / "cache", **changes)
    assert main(["replay", "run"]) == int(captured)


@pytest.mark.room("simulator")
def test_study_whose_settings_name_no_groups_has_none(place: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Of a simulated run no image was recorded with another; groups that were sealed into a study are refused."""
    folder = place
    assert (
        main(["search", *SIMULATED, *DRAWN, UNTRACKED, "search.generations=0", "search.initial=2", "run.dir=run"]) == 0
    )
    assert main(["study", *STUDY]) == 0
    (study,) = studies_of(Path("run"))
    header = study.read_scores().header
    images = header.data.counts[2]
    data = replace(header.data, groups=tuple(at // 2 for at in range(images)))
    moved = rewrite_study(study, folder / "cache", data=data)
    assert main(["replay", "run"]) == 2
    assert "data.groups" in capfd.readouterr().err
    with refused(RunError, place="data.groups", got=f"{data.units} groups"):
        replay_study(read_run(Path("run")), moved.read_finished())
    assert main(["tables", "run", "-o", "out"]) == 1
    assert "data.groups" in capfd.readouterr().err


def test_changed_score_is_a_difference(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """However well it is sealed, the store knows better; replay and study both name the row."""
    (directory,) = studies_of(folder / "run")
    scores = directory.read_scores()
    rows = [replace(row, epoch=9) if isinstance(row, ScoreLine) else row for row in scores.rows[-1:]]
    directory.scores.unlink()
    directory.finish(scores.header, [*scores.rows[:-1], *rows])
    for command in (["replay", "run"], ["study", *STUDY]):
        assert main(command) == 1
        assert "variant 1, seed 1, epoch: expected 9 as recorded; got" in capsys.readouterr().err


@pytest.mark.room("image tests")
def test_predictions_are_kept_and_give_the_scores(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of the epoch that is tested, for every training; a replay without them says which is missing."""
    from analysis.studies.image_findings import load_predictions

    predictions = load_predictions(load_study(only(folder)), folder / "cache")
    assert predictions is not None
    shapes = {name: each.shape for name, each in predictions.of.items()}
    assert shapes == dict.fromkeys(("baseline", "variant 1"), (2, *predictions.labels.shape))
    for path in folder.glob("cache/arrays/*/*.json"):
        path.unlink()
    assert main(["replay", "run"]) == 2
    assert "restore it; or delete that training from the store, and study again" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("edit", "status", "said"),
    [
        ({"scale": [1.0]}, 2, "study.json, scale: expected 3 values"),
        ({"scale": [1.0, 2.0, 3.0]}, 1, ", metrics.recorded_mae_F"),
        ({"task": "grating"}, 1, "study.json: expected the study that follows from the run"),
        ({"digest": "0" * 64}, 1, "study.json, digest: expected "),
        (
            {"terms": {"alpha": 0.05, "margin": {"value": 9.0, "kind": "relative"}}},
            1,
            "the study's header, terms.margin.value",
        ),
        ({"terms": {}}, 2, "study.json, terms.alpha: expected a value"),
        ({"recipe": {}}, 2, "study.json, recipe.epochs: expected a value"),
    ],
)
def test_edited_description_is_found(
    edit: dict[str, Any], status: int, said: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A replay compares it with the run and the scores."""
    path = next(folder.glob("run/studies/*/study.json"))
    path.write_text(json.dumps({**json.loads(path.read_text()), **edit}))
    assert main(["replay", "run"]) == status
    assert said in capsys.readouterr().err


@pytest.mark.slow
def test_network_that_comes_to_no_end_is_told_and_the_rest_is_finished(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Out of time, it is a row without a score: the study ends with status 1, and no statistics take it."""
    forget(folder)
    assert main(["study", *STUDY, "seconds=0.01"]) == 1
    output = capsys.readouterr().out
    assert output.count("failed: ") == 4
    assert "failed: variant 1, seed 1: out_of_time" in output
    assert output.splitlines()[-1].startswith("digest: ")
    with refused(RunError, got="failed (out_of_time): baseline with seed 0"):
        load_study(only(folder))
    assert main(["replay", "run"]) == 0


def test_export_takes_the_study_along(folder: Path) -> None:
    """What is imported elsewhere replays run and study."""
    assert main(["cache", "export", "run", "-o", "run.jsonl.xz"]) == 0
    assert main(["cache", "import", "run.jsonl.xz", "--store", "other"]) == 0
    assert main(["replay", "run", "--store", "other"]) == 0
    assert len(list(folder.glob("other/studies/*/*.json"))) == 4
    assert len(list(folder.glob("other/arrays/*/*.json"))) == 5  # predictions, and the labels once
    for path in folder.glob("other/studies/*/*.json"):
        check_entry(path, path.read_bytes(), "studies", path.stem)


@pytest.mark.slow
def test_study_of_a_run_that_was_extended_is_passed_over(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A longer search has other elites; its replay says so, and a new study has a directory of its own."""
    longer = ["search.generations=1", "search.candidates=1"]
    assert main(["search", *TINY[:-1], *longer[1:], "run.dir=longer"]) == 0
    assert main(["study", "run=longer", *STUDY[1:]]) == 0
    assert main(["search", *TINY[:-1], *longer, "run.dir=longer"]) == 0
    capsys.readouterr()
    assert main(["replay", "longer"]) == 0
    output = capsys.readouterr()
    assert "is about the run before it was extended, and is passed over" in output.err
    assert "every score is as recorded" not in output.out
    assert main(["study", "run=longer", *STUDY[1:]]) == 0
    runs = [load_study(directory.path).run for directory in studies_of(folder / "longer")]
    assert len(runs) == 2
    assert runs.count(read_run(folder / "longer").digest) == 1


def test_unfinished_run_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One whose ledger ends early, and one whose candidate was edited."""
    ledger = folder / "run" / "ledger.jsonl"
    text = ledger.read_text()
    ledger.write_text("\n".join(text.splitlines()[:-1]) + "\n")
    assert main(["study", *STUDY]) == 2
    assert "run: expected a finished run" in capsys.readouterr().err
    ledger.write_text(text)
    with (folder / "run" / "candidates" / "g00s00.py").open("a") as file:
        file.write("# better\n")
    assert main(["study", *STUDY]) == 2
    assert "g00s00.py: expected the source whose hash the ledger has" in capsys.readouterr().err


def test_other_data_are_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is trained on images that the run did not have."""
    path = folder / "run" / "run.json"
    run = json.loads(path.read_text())
    run["config"]["data"]["seed"] += 1
    path.write_text(json.dumps(run))
    assert main(["study", *STUDY]) == 2
    assert "restore the data set of the run" in capsys.readouterr().err


def test_network_whose_trainings_are_made_twice_is_named_once() -> None:
    """While it is trained, and however many seeds it has; what was recorded before took nothing."""
    jobs: list[Any] = [
        SimpleNamespace(network=SimpleNamespace(name=name), source=name, seed=seed, row=f"{name}, seed {seed}")
        for name in ("baseline", "variant 1", "variant 2")
        for seed in range(3)
    ]
    outside: Any = SimpleNamespace(evaluate=lambda *_: None, twice={("variant 1", 0), ("variant 1", 2)})
    view = Heard()
    with ThreadPoolExecutor() as executor:
        _train(jobs, {"variant 2, seed 0"}, outside, executor, view)
    told = [line for line in view.lines if "made twice" in line]
    assert told == ["variant 1 learns outside its weights and buffers, so each of its trainings is made twice"]
