"""Promise: an exported network is the one that was recorded, needs no tacevo, and is whole or absent."""

import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import venv
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
from checkout import ROOT
from packaging.requirements import Requirement
from PIL import Image
from refusals import refused
from rich.console import Console
from safetensors.numpy import load_file, save
from smallest import Once
from tests_own import Touches

import tacevo
from tacevo.cli.app import main
from tacevo.errors import BundleError, ConfigError, DivergenceError, RunError
from tacevo.evolution.lines import CandidateLine
from tacevo.export import directory
from tacevo.export.trainings import ExportSettings, Like, design, train
from tacevo.parts.source import Catalogue
from tacevo.records import Mode, to_json
from tacevo.results.study_directory import StudyDirectory, plain_study, studies_of
from tacevo.results.study_lines import Row, ScoreLine
from tacevo.rules import STUDY, TRAININGS_OF_STUDIES
from tacevo.runs.datasets import load_same
from tacevo.runs.progress import Progress
from tacevo.sandbox.client import Sandbox
from tacevo.storage.array_store import KIND, ArrayStore
from tacevo.storage.canonical import readable
from tacevo.storage.ledger import sealed_text
from tacevo.storage.store import Entry, Store
from tacevo.training.full import read_kept, score
from tacevo.training.weights import weights_digest

BUNDLES = sorted((ROOT / "cache" / "published").glob("*.zip"))

#: Runs a program where only the packages of its second argument, and what these need, can be imported.
ALONE = """
import sys
program, allowed = sys.argv[1], set(sys.argv[2].split(","))
hidden = {"tacevo", "analysis", "onnx", "onnxscript", "onnxruntime", "torch", "safetensors"} - allowed
class Hiding:
    def __init__(self, finder):
        self._finder = finder
    def __getattr__(self, name):
        return getattr(self._finder, name)
    def find_spec(self, name, path=None, target=None):
        return None if name.partition(".")[0] in hidden else self._finder.find_spec(name, path, target)
sys.meta_path[:] = map(Hiding, sys.meta_path)
sys.path.insert(0, "")
exec(compile(program, "README.md", "exec"))
"""


def studied(published: Path) -> tuple[tacevo.Run, str]:
    """Open the session's run; return it with the elite that its study is about."""
    run = tacevo.open(published / "run")
    assert isinstance(run, tacevo.Run)
    return run, str(run.studies[0].networks["id"].iloc[1])


def scores(run: tacevo.Run, name: str) -> list[ScoreLine]:
    """Return what the study recorded of a network, by seed."""
    rows = run.studies[0]._finished.rows
    return [row for row in rows if isinstance(row, ScoreLine) and row.id == name]


@pytest.fixture(scope="module")
def exported(once: Once, published: Path) -> Path:
    """Export an ensemble of two trainings of that study."""

    def fill(folder: Path) -> None:
        run, name = studied(published)
        run.export(name, folder / "model", seeds=2, retrained=True, quiet=True)
        dataset = load_same(run.config, run.recorded.facts, Progress(Console(quiet=True)))
        np.save(folder / "images.npy", np.load(dataset.images)[dataset.test])
        kept = [row.kept for row in scores(run, name)[:2]]
        arrays = ArrayStore(Store(Path(run.config.store.root), "arrays"))
        values = [read_kept(arrays, one, run.recorded.facts)[0] for one in kept if one is not None]
        np.save(folder / "expected.npy", np.mean(values, axis=0) * dataset.scale + dataset.offset)

    return once("exported-network", fill)


def read(exported: Path, name: str) -> Any:
    """Read a JSON file of the export."""
    return json.loads((exported / "model" / name).read_text())


@pytest.mark.slow
def test_files_are_those_of_the_page(exported: Path) -> None:
    """No more and no fewer; the class comes with its imports, and no file names a directory of this machine."""
    files = {path.name: path.read_bytes() for path in (exported / "model").iterdir()}
    weights = {"weights-1.safetensors", "weights-2.safetensors"}
    texts = {"README.md", "model.py", "config.json", "latency.json", "run.json"}
    assert files.keys() == weights | texts | {"model.onnx"}
    assert files["model.py"].startswith((b"import torch", b'"""'))
    for content in files.values():
        assert not re.search(rb"site-packages|/home/|/root/|" + os.fsencode(ROOT), content)


@pytest.mark.slow
def test_weights_are_the_recorded_ones(exported: Path, published: Path) -> None:
    """By the digest that the scores of the study have, where the best epoch is the last."""
    run, name = studied(published)
    rows = scores(run, name)
    digests = [weights_digest(load_file(exported / "model" / f"weights-{number}.safetensors")) for number in (1, 2)]
    assert digests == [row.weights for row in rows[:2]] == read(exported, "config.json")["weights_sha256"]
    assert "the recorded ones, bit for bit" in (exported / "model" / "README.md").read_text()


@pytest.mark.slow
def test_onnx_takes_raw_images_and_gives_newtons(exported: Path) -> None:
    """The mean of what the study's trainings predicted for its test images, for any number of them."""
    images, expected = np.load(exported / "images.npy").astype(np.float32), np.load(exported / "expected.npy")
    session = onnxruntime.InferenceSession(exported / "model" / "model.onnx", providers=["CPUExecutionProvider"])
    for part in (slice(0, 1), slice(0, 3), slice(None)):
        (values,) = session.run(None, {"images": images[part]})
        assert values == pytest.approx(expected[part], abs=1e-5)
    assert max(read(exported, "config.json")["largest_difference"].values()) < 1e-5


@pytest.mark.slow
def test_card_and_run_name_where_it_comes_from(exported: Path, published: Path) -> None:
    """What is needed to find the run again; and what the metrics are of."""
    run, name = studied(published)
    told, card = read(exported, "run.json"), (exported / "model" / "README.md").read_text()
    assert (told["digest"], told["candidate"], told["run"]) == (run.digest, name, run.name)
    assert [one["was_recorded"] for one in told["trainings"]] == [True, True]
    assert told["study"] == run.studies[0].digest
    for text in (
        "license: cc-by-4.0",
        run.digest,
        "ensemble of 2",
        "2 of its 4 seeds were trained again here",
        "Fx (N)",
        "type: r2",
    ):
        assert text in card
    for times in read(exported, "latency.json")["milliseconds"].values():
        assert all(0 < one["lower_quartile"] <= one["median"] for one in times.values())


def programs(exported: Path) -> list[str]:
    """Return the programs of the card: with onnxruntime, and with the class."""
    return re.findall(r"```python\n(.*?)```", (exported / "model" / "README.md").read_text(), re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "allowed"), [(0, "onnxruntime"), (1, "torch,safetensors")])
def test_programs_of_the_card_run_without_tacevo(number: int, allowed: str, exported: Path, place: Path) -> None:
    """They print the forces in one image, those of the whole ensemble."""
    for file in (exported / "model").iterdir():
        (place / file.name).symlink_to(file)
    pixels, expected = np.load(exported / "images.npy")[0], np.load(exported / "expected.npy")[0]
    Image.fromarray(pixels.transpose(1, 2, 0)).save(place / "image.png")
    command = [sys.executable, "-c", ALONE, programs(exported)[number], allowed]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=place)
    lines = [line.split() for line in done.stdout.splitlines()]
    assert [(name, unit) for name, _, unit in lines] == [("Fx", "N"), ("Fy", "N"), ("Fz", "N")]
    assert [float(value) for _, value, _ in lines] == pytest.approx(expected.tolist(), rel=1e-3)


@pytest.mark.slow
def test_trainings_repeat_bit_for_bit(published: Path) -> None:
    """The same bytes of weights each time, like the search and like its study."""
    run, name = studied(published)
    recorded, view = run.recorded, Progress(Console(quiet=True))
    line = next(line for line in recorded.candidates if line.id == name)
    data = load_same(recorded.config, recorded.facts, view)
    for like in Like:
        plan = design(recorded, line, ExportSettings(like=like))
        source = recorded.directory.read_source(name, str(line.source))
        files = []
        for _ in range(2):
            (one,), _ = train(recorded, plan, source, data, view, retrained=True)
            assert one.differing == ()
            files.append(save(dict(one.weighed.weights)))
        assert files[0] == files[1]
        assert like is Like.study or weights_digest(one.weighed.weights) == line.weights


def test_missing_record_is_an_error_if_nothing_is_believed(published: Path, place: Path) -> None:
    """Without `retrained` it is trained; with it, a training that no one recorded is refused before it starts."""
    run, name = studied(published)
    with refused(RunError, got="no record of it"):
        run.export(name, place / "model", epochs=2, like="search", retrained=True, quiet=True)
    assert not (place / "model").exists()


def test_other_record_is_an_error_if_nothing_is_believed(folder: Path) -> None:
    """One other digest of weights in the store is named."""
    run = tacevo.open("run")
    assert isinstance(run, tacevo.Run)
    line = next(line for line in run.recorded.trained if line.weights)
    for path in Path("cache/evaluations").rglob("*.json"):
        entry = json.loads(path.read_text().replace(str(line.weights), "0" * 64))
        again = Entry(kind=entry["kind"], request=entry["request"], answer=entry["answer"])
        path.write_text(json.dumps(again.sealed()))
    with refused(DivergenceError, got="other weights_sha256"):
        run.export(line.id, "model", like="search", retrained=True, quiet=True)
    assert not Path("model").exists()


def _with_scores(directory: StudyDirectory, rows: Sequence[Row]) -> tacevo.Run:
    """Write other scores into a study, with the hashes of them, and open its run."""
    text, digest = sealed_text([directory.read_scores().header, *rows])
    record = replace(directory.read(), digest=digest)
    directory.scores.write_text(text)
    (directory.path / "study.json").write_text(readable(plain_study(record)))
    run = tacevo.open("run")
    assert isinstance(run, tacevo.Run)
    return run


def test_forged_study_is_not_repeated(folder: Path) -> None:
    """Its metrics do not follow from its test predictions; like the search, the network is exported without it."""
    (directory,) = [one for one in studies_of(Path("run")) if one.read().terms is not None]
    scores, record = directory.read_scores(), directory.read()
    rows = [
        replace(row, metrics=dict.fromkeys(row.metrics, 0.991)) for row in scores.rows if isinstance(row, ScoreLine)
    ]
    run = _with_scores(directory, rows)
    name = record.networks[1].id
    for retrained in (False, True):
        with refused(DivergenceError, place="metrics", expected="0.991"):
            run.export(name, "model", retrained=retrained, quiet=True)
    line = next(line for line in run.recorded.candidates if line.id == name)
    assert design(run.recorded, line, ExportSettings(like=Like.search)).scores == ()


def test_study_of_forged_labels_is_not_cited(folder: Path) -> None:
    """Metrics, predictions and labels agree in the stores, but the labels are not those of the data."""
    (directory,) = [one for one in studies_of(Path("run")) if one.read().terms is not None]
    scores, record, rows = directory.read_scores(), directory.read(), []
    arrays = ArrayStore(Store(Path("cache"), KIND, Mode.record))
    stored = {path: json.loads(path.read_text()) for path in Path("cache/studies").rglob("*.json")}
    for row in scores.rows:
        assert isinstance(row, ScoreLine)
        assert row.kept is not None
        predictions, _ = read_kept(arrays, row.kept, record.data)
        arrays.keep(predictions)
        kept = replace(row.kept, labels=row.kept.predictions)
        metrics, _ = score(record.data.kind, predictions, predictions, names=record.data.names, scale=record.scale)
        for path, entry in stored.items():
            if (told := entry["answer"].get("full", {})).get("kept") == to_json(row.kept):
                told |= {"metrics": metrics, "kept": to_json(kept)}
                again = Entry(kind=entry["kind"], request=entry["request"], answer=entry["answer"])
                path.write_text(json.dumps(again.sealed()))
        rows.append(replace(row, metrics=metrics, kept=kept))
    run = _with_scores(directory, rows)
    name = record.networks[1].id
    line = next(line for line in run.recorded.candidates if line.id == name)
    assert design(run.recorded, line, ExportSettings()).scores  # as far as the stores say
    with refused(DivergenceError, place="kept.labels"):
        run.export(name, "model", quiet=True)
    assert not Path("model").exists()


def test_study_whose_predictions_are_gone_is_not_cited(folder: Path) -> None:
    """Nor one whose stores have none; its trainings are repeated all the same, and are no record."""
    run = tacevo.open("run")
    assert isinstance(run, tacevo.Run)
    name, recorded = str(run.studies[0].networks["id"].iloc[1]), run.recorded
    line = next(line for line in recorded.candidates if line.id == name)
    whole = design(recorded, line, ExportSettings())
    assert (len(whole.scores) > 1, whole.uncited) == (True, "")
    without = design(replace(recorded, has_predictions=False), line, ExportSettings())
    assert (without.scores, without.uncited) == ((), "the bundle of a sweep holds no test predictions")
    assert without.recorded.keys() == whole.recorded.keys()
    shutil.rmtree("cache/arrays")
    plan = design(recorded, line, ExportSettings())
    assert (plan.study, plan.seeds, plan.scores) == (whole.study, whole.seeds, ())
    assert "the stores lack" in plan.uncited
    assert not {row.evaluation for row in whole.scores} & plan.recorded.keys()


def test_forged_line_of_the_ledger_is_another_record(published: Path) -> None:
    """Though the store agrees with the training: the ledger is what a reader was shown."""
    run, name = studied(published)
    recorded, view = run.recorded, Progress(Console(quiet=True))
    line = next(line for line in recorded.candidates if line.id == name)
    plan = design(recorded, line, ExportSettings(like=Like.search))
    lines = {key: one for key, one in plan.recorded.items() if isinstance(one, CandidateLine)}
    forged = {key: replace(one, validation_losses=(0.0,)) for key, one in lines.items()}
    source = recorded.directory.read_source(name, str(line.source))
    data = load_same(recorded.config, recorded.facts, view)
    with refused(DivergenceError, got="other validation_losses"):
        train(recorded, replace(plan, recorded=forged), source, data, view, retrained=True)
    better = {key: replace(one, fitness=0.001) for key, one in lines.items()}
    with refused(DivergenceError, got="other fitness"):
        train(recorded, replace(plan, recorded=better), source, data, view, retrained=True)


def test_what_no_record_names_is_no_record(folder: Path) -> None:
    """The store alone may hold what an export trained; here what a study did, which is deleted."""
    run = tacevo.open("run")
    assert isinstance(run, tacevo.Run)
    name, rows = str(run.studies[0].networks["id"].iloc[1]), run.studies[0]._finished.rows
    line = next(line for line in run.recorded.candidates if line.id == name)
    keys = {row.evaluation for row in rows}
    assert keys <= design(run.recorded, line, ExportSettings()).recorded.keys()
    shutil.rmtree("run/studies")
    run.forget()
    plan = design(run.recorded, line, ExportSettings(epochs=1))
    assert not keys & plan.recorded.keys()
    assert all(Path("cache/studies", key[:2], f"{key}.json").exists() for key in keys)
    with refused(RunError, got="no record of it"):
        run.export(name, "model", epochs=1, retrained=True, quiet=True)


def test_epochs_choose_among_studies(published: Path) -> None:
    """A study of as many epochs is repeated; without one it is a study by default of so many."""
    run, name = studied(published)
    line = next(line for line in run.recorded.candidates if line.id == name)
    one, other = (design(run.recorded, line, ExportSettings(epochs=epochs)) for epochs in (1, 7))
    assert one == design(run.recorded, line, ExportSettings())
    assert (other.study, other.scores, other.config.training.epochs) == (None, (), 7)


@pytest.mark.slow
def test_seeds_that_an_older_study_lacks_are_trained(folder: Path) -> None:
    """By its rules, and twice; under these nothing is stored."""
    run = tacevo.open("run")
    assert isinstance(run, tacevo.Run)
    name = str(run.studies[0].networks["id"].iloc[1])
    recorded, view = run.recorded, Progress(Console(quiet=True))
    line = next(line for line in recorded.candidates if line.id == name)
    source, data = recorded.directory.read_source(name, str(line.source)), load_same(run.config, recorded.facts, view)
    stored = sorted(Path("cache/studies").rglob("*.json"))
    for rules in TRAININGS_OF_STUDIES.keys() - {STUDY}:
        plan = replace(design(recorded, line, ExportSettings()), rules=rules)
        (one,), _ = train(recorded, plan, source, data, view, retrained=False)
        assert (one.was_recorded, one.differing) == (False, ())
    assert sorted(Path("cache/studies").rglob("*.json")) == stored


@pytest.mark.parametrize(("parameters", "seeds", "place"), [(17_000_000, 1, "g00s02"), (3_000_000, 60, "seeds")])
def test_too_large_is_refused_before_it_is_trained(parameters: int, seeds: int, place: str, published: Path) -> None:
    """A network by the parameters that the ledger has of it; an ensemble by its number of them."""
    run, _ = studied(published)
    line = next(line for line in run.recorded.candidates if line.id == "g00s02")
    with refused(RunError, place=place):
        directory.export(
            run.recorded,
            replace(line, parameters=parameters),
            Path("never"),
            ExportSettings(seeds=seeds),
            bundle=None,
            retrained=False,
            view=Progress(Console(quiet=True)),
        )


def test_images_are_listed_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A recording is large, and every header of it is read each time."""
    listed: list[Touches] = []

    def list_it(source: Touches) -> Catalogue:
        listed.append(source)
        return catalogue(source)

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    catalogue = Touches.catalogue
    monkeypatch.setattr(Touches, "catalogue", list_it)
    monkeypatch.setattr(directory, "train", stop)
    shutil.rmtree("cache/data")
    run = tacevo.open("run")
    assert isinstance(run, tacevo.Run)
    with pytest.raises(KeyboardInterrupt):
        run.export(str(run.elites["id"].iloc[0]), "model", quiet=True)
    assert len(listed) == 1


def test_interruption_says_what_is_left(published: Path, place: Path, capfd: Any, monkeypatch: Any) -> None:
    """No part of a directory, which the command says."""

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(directory, "train", stop)
    run, name = studied(published)
    assert main(["export", str(run.path), name, "-o", "model"]) == 130
    assert "interrupted; the directory is whole or absent" in capfd.readouterr().err
    assert not [*place.iterdir()]


@pytest.mark.parametrize(
    ("settings", "place"),
    [
        ({"seeds": 0}, "seeds"),
        ({"seeds": "two"}, "seeds"),
        ({"epochs": 0}, "epochs"),
        ({"like": "both"}, "like"),
        ({"licence": "a: b"}, "licence"),
        ({"sedes": 2}, "sedes"),
    ],
)
def test_wrong_setting_is_refused(settings: dict[str, Any], place: str, published: Path) -> None:
    """Before anything is trained."""
    run, name = studied(published)
    with refused(ConfigError, place=f"export, {place}"):
        run.export(name, "never", **settings, quiet=True)


def test_what_exists_is_not_written_over(published: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither a directory nor a file; the command says so, and names the directory."""
    _, name = studied(published)
    (place / "model").mkdir()
    assert main(["export", str(published / "run"), name, "-o", "model", "like=search"]) == 2
    assert "model: expected a directory to be made; got one that exists" in capsys.readouterr().err
    assert main(["export", str(published / "run"), name, "-o", "other", "like"]) == 2
    assert main(["export", str(published / "run"), "g99s99", "-o", "other"]) == 2
    assert [path.name for path in place.iterdir()] == ["model"]


def test_missing_packages_are_named_with_the_remedy(monkeypatch: pytest.MonkeyPatch, published: Path) -> None:
    """The extra is what brings them."""
    run, name = studied(published)
    monkeypatch.setattr(directory, "find_spec", lambda each: None if each == "onnxscript" else find_spec(each))
    with refused(ConfigError, got="no onnxscript", remedy="pip install -e '.[export]'"):
        run.export(name, "never", quiet=True)


@pytest.mark.parametrize("call", ["rename", "fsync"])
def test_interrupted_export_leaves_nothing(call: str, monkeypatch: pytest.MonkeyPatch, place: Path) -> None:
    """Whenever it is stopped while it writes."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(os, call, interrupt)
        with pytest.raises(KeyboardInterrupt):
            directory._write(place / "model", {"a": b"1", "b": b"2"})
    assert not [*place.iterdir()]
    directory._write(place / "model", {"a": b"1"})
    assert {path.name: path.read_bytes() for path in (place / "model").iterdir()} == {"a": b"1"}
    with refused(ConfigError, got="one that exists"):
        directory._write(place / "model", {"a": b"2"})


def test_bundle_is_asked_for_its_walls(published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As for `replay --retrain`: a stranger's code must not run here unconfined."""
    run = tacevo.open(published / "run.zip")
    assert isinstance(run, tacevo.Run)

    def refuse(place: object) -> None:
        assert place is run.place
        raise BundleError("no walls")

    monkeypatch.setattr("tacevo.api.runs.check_walls", refuse)
    with refused(BundleError, got="no walls"):
        run.export(str(run.elites["id"].iloc[0]), "never", quiet=True)


@pytest.mark.slow
def test_source_is_shown_as_the_file_that_is_exported(
    exported: Path, published: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a run and of its bundle; not of a candidate that is not there, or of none."""
    _, name = studied(published)
    for run in ("run", "run.zip"):
        assert main(["show", str(published / run), name, "--source"]) == 0
        assert capsys.readouterr().out == (exported / "model" / "model.py").read_text()
    assert main(["show", str(published / "run"), "g99s99", "--source"]) == 2
    assert main(["show", str(published / "run"), "--source"]) == 2


def needed_by(package: str) -> set[str]:
    """Return a distribution and all that it requires here, by name."""
    names: set[str] = set()
    waiting = [package]
    while waiting:
        name = waiting.pop()
        names.add(name)
        required = [Requirement(text) for text in metadata.requires(name) or []]
        known = [one.name for one in required if one.marker is None or one.marker.evaluate({"extra": ""})]
        waiting += [one for one in known if one not in names]
    return names


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "packages"),
    [(0, ["onnxruntime", "numpy", "pillow"]), (1, ["torch", "safetensors", "numpy", "pillow"])],
)
def test_programs_of_the_card_run_in_a_fresh_environment(
    number: int, packages: list[str], exported: Path, place: Path
) -> None:
    """One that has what the card says, and what this needs; linked, not installed."""
    venv.create(place / "fresh", with_pip=False)
    (target,) = (place / "fresh").glob("lib/*/site-packages")
    for name in set().union(*map(needed_by, packages)):
        tops = {file.parts[0] for file in metadata.files(name) or []} - {"..", "__pycache__"}
        for top in tops:
            (target / top).symlink_to(Path(str(metadata.distribution(name).locate_file(top))))
    for file in (exported / "model").iterdir():
        (place / file.name).symlink_to(file)
    Image.fromarray(np.load(exported / "images.npy")[0].transpose(1, 2, 0)).save(place / "image.png")
    (place / "program.py").write_text(programs(exported)[number])
    python = place / "fresh" / "bin" / "python"
    done = subprocess.run([python, "program.py"], capture_output=True, text=True, check=True, cwd=place)
    assert len(done.stdout.splitlines()) == 3
    assert subprocess.run([python, "-c", "import tacevo"], capture_output=True, check=False).returncode != 0


@pytest.fixture
def one_converter(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Convert the networks of one data set in one sandbox, whose start takes longer than a conversion."""
    with contextlib.ExitStack() as stack:
        known: list[tuple[dict[str, Any], Sandbox]] = []

        @contextlib.contextmanager
        def sandbox(**settings: Any) -> Iterator[Sandbox]:
            if not known or known[-1][0] != settings:
                stack.close()
                known.append((settings, stack.enter_context(Sandbox(**settings))))
            yield known[-1][1]

        monkeypatch.setattr(directory, "Sandbox", sandbox)
        yield


@pytest.mark.long
@pytest.mark.timeout(4 * 3600)
@pytest.mark.parametrize("bundle", BUNDLES, ids=lambda path: path.stem)
def test_every_elite_of_the_shipped_bundles_exports(bundle: Path, place: Path, one_converter: None) -> None:
    """Each source: the first of a run like its search, with the recorded weights, the others once, for one epoch."""
    run, known = tacevo.open(bundle), set[str]()
    for number, one in enumerate([run] if isinstance(run, tacevo.Run) else run.runs):
        for rank, (name, source) in enumerate(one.candidates.loc[one.elites["id"], "source"].items()):
            if rank and source in known:
                continue
            known.add(source)
            target = place / str(number) / str(name)
            shorter: dict[str, Any] = {"epochs": 1} if rank else {}
            one.export(str(name), target, like="search", quiet=True, **shorter)
            told = json.loads((target / "run.json").read_text())
            assert [each["differs_from_record"] for each in told["trainings"]] == [None if rank else []]
            shutil.rmtree(target)  # all of them would fill a disk
    assert known
