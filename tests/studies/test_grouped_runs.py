"""Promise: a run on recordings with groups says which test images share one, and its figures count each group once."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bundles import members_of, resealed
from commands import publish
from refusals import refused
from rewritten import rewrite_study
from rich.console import Console
from smallest import ARCHIVES, DRAWN, UNTRACKED, Once

from analysis.report.collection import collect
from tacevo.cli.app import main
from tacevo.errors import DataError, RunError
from tacevo.evolution.run_files import RunLine, read_ledger
from tacevo.results.run import read_run
from tacevo.results.study_directory import studies_of
from tacevo.results.summary import summarise
from tacevo.rules import STUDY as STUDY_RULES
from tacevo.runs.datasets import load_same
from tacevo.runs.progress import Progress
from tacevo.storage.canonical import readable
from tacevo.storage.ledger import sealed_text
from tacevo.storage.run_directory import RunDirectory

pytestmark = pytest.mark.timeout(300)

#: Presses, and frames of each.
PRESSES, FRAMES = 24, 3

SEARCH = [
    *("experiment=published_force", "data=numpy", "data.root=rec.npz", "task.output_names=[]", "data.image_size=32"),
    *("data.test_part=0.25", "training.epochs=1", *ARCHIVES, UNTRACKED, *DRAWN),
    *("search.generations=0", "search.initial=2", "run.dir=run"),
]
STUDY = ["study", "run=run", "elites=1", "seeds=4", "epochs=1"]


def record_presses(path: Path) -> None:
    """Write an archive of presses, each with frames that differ by noise alone, in a mixed order."""
    rng = np.random.default_rng(0)
    labels = rng.uniform(0, 1, size=(PRESSES, 3))
    rows = rng.permutation(np.repeat(np.arange(PRESSES), FRAMES))
    shades = np.repeat((200 * labels[rows]).astype(int)[:, None, None, :], 32, axis=1).repeat(32, axis=2)
    images = (shades + rng.integers(0, 40, size=shades.shape)).astype(np.uint8)
    np.savez(path, images=images, labels=labels[rows], groups=rows)


@pytest.fixture(scope="module")
def made(once: Once) -> Path:
    """Return a directory with a recording, a run on it with a study, and both as a bundle; no test may change it."""

    def fill(folder: Path) -> None:
        record_presses(folder / "rec.npz")
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            assert main(["search", *SEARCH]) == 0
            assert main(STUDY) == 0
            publish("run", "-o", "run.zip", "--author", "A. Nyone")

    return once("grouped", fill)


@pytest.fixture
def folder(made: Path, place: Path) -> Path:
    """Work in a copy of it."""
    shutil.copytree(made, place, dirs_exist_ok=True)
    return place


def as_of_an_earlier_release(groups: tuple[int, ...] = ()) -> None:
    """Rewrite the run here as one that records these groups, and its study; hashes and digests are sound."""
    directory = RunDirectory(Path("run"))
    header, *lines = read_ledger(directory).lines
    assert isinstance(header, RunLine)
    text, digest = sealed_text([replace(header, data=replace(header.data, groups=groups)), *lines])
    directory.write_text("ledger.jsonl", text)
    record = directory.read_run()
    directory.write_run(replace(record, data=replace(record.data, groups=groups), digest=digest))
    directory.write_text("summary.md", summarise(read_run(directory.path)))
    for study in studies_of(Path("run")):
        data = replace(study.read().data, groups=groups)
        rewrite_study(study, Path("cache"), run=digest, data=data, rules=STUDY_RULES - 1)


def test_groups_stand_in_the_run_its_study_and_its_bundle(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the archive has them, for each test image, numbered as they come: what the archive calls them is not told."""
    monkeypatch.chdir(made)
    run = read_run(made / "run")
    with np.load(made / "rec.npz") as archive:
        groups = archive["groups"]
    data = load_same(run.config, run.facts, Progress(Console(quiet=True)))
    tested = groups[data.test].tolist()
    assert run.facts.groups == tuple(map(list(dict.fromkeys(tested)).index, tested))
    assert (run.facts.units, run.facts.counts[2]) == (6, 18)
    (study,) = studies_of(made / "run")
    assert study.read().data == study.read_scores().header.data == run.header.data == run.facts
    assert json.loads(members_of(made / "run.zip")["run/run.json"])["data"]["groups"] == list(run.facts.groups)


@pytest.mark.room("image tests")
def test_tables_count_each_group_once(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On each output the variant is better or worse on six groups, of which the 18 images are."""
    monkeypatch.chdir(made)
    (compared,) = collect(Path("run")).studies
    assert compared.found["images"] is not None
    assert ((compared.found["images"][1].better + compared.found["images"][1].worse) == 6).all()
    assert compared.study.data.counts[2] == 18


def test_bundle_replays(folder: Path) -> None:
    """With its tables, and without the recording."""
    (folder / "rec.npz").unlink()
    shutil.rmtree(folder / "cache")
    assert main(["replay", "run.zip"]) == 0


def test_groups_of_a_run_are_compared_with_its_ledger(made: Path, tmp_path: Path) -> None:
    """Whoever edits run.json alone is found when it is read; whoever edits a study, by a replay."""
    members = members_of(made / "run.zip")
    described = json.loads(members["run/run.json"])
    described["data"]["groups"] = list(range(18))
    forged = resealed({**members, "run/run.json": readable(described).encode()}, tmp_path / "forged.zip")
    assert main(["tables", str(forged), "-o", str(tmp_path / "out")]) == 2
    (name,) = (name for name in members if name.endswith("study.json"))
    study = json.loads(members[name])
    study["data"]["groups"] = list(range(18))
    forged = resealed({**members, name: readable(study).encode()}, tmp_path / "study.zip")
    assert main(["replay", str(forged)]) == 1


def test_forged_groups_are_found_by_who_has_the_data(folder: Path) -> None:
    """A ledger that is sealed again replays; what loads the recording refuses it."""
    as_of_an_earlier_release(tuple(range(18)))
    assert main(["replay", "run"]) == 0
    run = read_run(Path("run"))
    with refused(DataError, got="other groups"):
        load_same(run.config, run.facts, Progress(Console(quiet=True)))
    assert main(["replay", "run", "--retrain"]) == 2


def test_run_whose_settings_name_no_groups_has_none(folder: Path) -> None:
    """Those of a table without a column or a pattern of groups, say, are made up."""
    described = json.loads((folder / "run" / "run.json").read_text())
    described["config"]["data"] |= {"source": "csv", "target_columns": ["x", "y", "z"]}
    (folder / "run" / "run.json").write_text(json.dumps(described))
    with refused(RunError, place="data.groups", got="6 groups"):
        read_run(Path("run"))


def test_run_of_an_earlier_release_is_studied_by_its_groups(folder: Path) -> None:
    """It replays as it is. The same study trains once more, under the rules of today, and has the groups."""
    as_of_an_earlier_release()
    assert main(["replay", "run"]) == 0
    trainings = set(folder.glob("cache/studies/*/*.json"))
    assert main(STUDY) == 0
    assert len(set(folder.glob("cache/studies/*/*.json")) - trainings) == 8
    groups = {study.read().data.units for study in studies_of(Path("run"))}
    assert groups == {18, 6}
    assert main(["replay", "run"]) == 0
    assert main(["study", *STUDY[1:], "data.split_seed=1"]) == 0
    elsewhere = [study for study in studies_of(Path("run")) if study.read().other_data]
    assert [study.read().data.units for study in elsewhere] == [6]


def test_only_studies_of_settings_with_groups_can_lack_them(folder: Path) -> None:
    """A column or a pattern that the run names, and no groups recorded: the tables warn. An archive may have none."""
    as_of_an_earlier_release()
    assert [one.study.lacks_groups for one in collect(Path("run")).studies] == [False]
    described = json.loads((folder / "run" / "run.json").read_text())
    described["config"]["data"] |= {"source": "csv", "target_columns": ["x", "y", "z"], "group_column": "press"}
    (folder / "run" / "run.json").write_text(json.dumps(described))
    assert [one.study.lacks_groups for one in collect(Path("run")).studies] == [True]
