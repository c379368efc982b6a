"""Promise: given networks are studied as those of a search are, on the run's data and on other data."""

import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import publish
from fakes import TASK
from refusals import refused
from small_recordings import simulated
from smallest import TOUCHES, UNTRACKED, Once

from tacevo.api.opening import open_run
from tacevo.choices import Numerics
from tacevo.cli.app import main
from tacevo.errors import CacheMissError, ConfigError, DivergenceError, TacevoError
from tacevo.records import Given, Operator
from tacevo.results.run import read_run
from tacevo.results.study_directory import StudyDirectory, studies_of, study_names
from tacevo.runs.given_networks import _check_different
from tacevo.runs.progress import Progress
from tacevo.studies.study import replay_studies

pytestmark = pytest.mark.timeout(300)

#: A network that trains in no time; `{}` is its width.
NETWORK = """\
import torch
import torch.nn as nn


class ImageRegressionCNN(nn.Module):
    def __init__(self, in_channels=3, num_outputs=3):
        super().__init__()
        self.conv = nn.Conv2d(in_channels, {}, 3, stride=4)
        self.head = nn.Linear({}, num_outputs)

    def forward(self, x):
        return self.head(torch.relu(self.conv(x)).mean((2, 3)))
"""

SETTINGS = [*TOUCHES, UNTRACKED, "seeds=2", "epochs=1", "run.dir=run", "store.root=cache"]

GIVEN = ["networks=[wide.py,narrow.py]", *SETTINGS]

#: Without the task, a network for another sensor would be trained on forces.
UNNAMED = [setting for setting in GIVEN if not setting.startswith("experiment=")]


@pytest.fixture(scope="session")
def given_study(once: Once) -> Path:
    """Return a directory with a run of two given networks, and its studies on two splits; no test may change it."""

    def study(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            for name, width in (("wide", 8), ("narrow", 2)):
                Path(f"{name}.py").write_text(NETWORK.format(width, width))
            assert main(["study", *GIVEN]) == 0
            assert main(["study", "run=run", "seeds=2", "epochs=1", "data.split_seed=7"]) == 0

    return once("given", study)


@pytest.fixture
def here(given_study: Path, place: Path) -> Path:
    """Work in a copy of it."""
    shutil.copytree(given_study, place, dirs_exist_ok=True)
    return place


def study_on(where: str) -> StudyDirectory:
    """Return the study of the run that is on these data."""
    (of_it,) = (directory for directory in studies_of(Path("run")) if directory.read().where == where)
    return of_it


def test_every_given_network_is_studied_under_its_name(here: Path) -> None:
    """In the order in which they were named, whatever their fitness; none competes for a niche."""
    run, networks = read_run(Path("run")), study_on("").read().networks
    asked = [(line.operator, line.request) for line in run.candidates]
    assert asked == [(Operator.baseline, None), (Operator.given, None), (Operator.given, None)]
    assert run.config.archive.kind == "best"
    named = {"baseline": "g00s00", "wide": "g00s01", "narrow": "g00s02"}
    assert {network.name: network.id for network in networks} == named
    assert networks[1].parameters > networks[2].parameters


def test_other_split_is_another_study_of_the_same_networks(here: Path) -> None:
    """Named by what differs; training seeds and networks are equal, data and trainings are not."""
    own, other = study_on("").read_scores(), study_on("split_seed=7").read_scores()
    assert "-split_seed-7-" in study_on("split_seed=7").path.name
    assert own.header.data.fingerprint != other.header.data.fingerprint
    assert (own.header.networks, own.header.recipe) == (other.header.networks, other.header.recipe)
    assert not {row.evaluation for row in own.rows} & {row.evaluation for row in other.rows}


@pytest.mark.room("export")
@pytest.mark.slow
def test_study_may_train_with_other_numerics_than_the_run(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What trained it is recorded, replayed and repeated by an export; what is said of it elsewhere is found out."""
    from tacevo.export.trainings import ExportSettings, design

    assert main(["study", "run=run", "seeds=2", "epochs=1", "numerics=fast"]) == 0
    assert "tested on 4 images, trained with numerics=fast" in capsys.readouterr().out
    (other_study,) = (one for one in studies_of(Path("run")) if one.read().trained_with == "numerics=fast")
    (own_study,) = (one for one in studies_of(Path("run")) if not one.read().apart)
    own, other = own_study.read(), other_study.read()
    assert (own.numerics, other.numerics) == (Numerics.portable, Numerics.fast)
    assert (own.networks, own.recipe, own.data) == (other.networks, other.recipe, other.data)
    run = read_run(Path("run"))
    assert len(replay_studies(run, Progress())) == 3
    place = other_study.path
    shutil.rmtree(own_study.path)
    line = next(line for line in run.candidates if line.id == "g00s01")
    plan = design(run, line, ExportSettings(seeds=1))
    assert (plan.config.numerics.kind, plan.config.training.epochs) == (Numerics.fast, 1)
    assert plan.study is not None
    assert (plan.study.path, len(plan.scores)) == (place, 2)
    told = json.loads((place / "study.json").read_text())
    changes: list[dict[str, object]] = [
        {"other_device": []},
        {"numerics": "portable"},
        {"other_device": [["training.device", "cuda"]]},
    ]
    for change in changes:
        (place / "study.json").write_text(json.dumps(told | change))
        with pytest.raises(TacevoError):
            replay_studies(run, Progress())


@pytest.mark.slow
def test_same_commands_again_train_nothing(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They find run and study again; of other settings that lead to the run's data the content decides."""
    before = {path: path.read_bytes() for path in here.glob("run/studies/*/*")}
    for command in (GIVEN, *(["run=run", "seeds=2", "epochs=1", f"data.split_seed={seed}"] for seed in (7, 0))):
        assert main(["study", *command]) == 0
        assert "(6 of 6 trainings recorded already)" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in here.glob("run/studies/*/*")} == before


@pytest.mark.slow
def test_several_data_sets_are_studied_one_after_the_other(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By commas; they end in one table, whatever older studies on equal data there are.

    A value that is wrong is told before the first is studied.
    """
    for older in sorted(here.glob("run/studies/*")):
        shutil.copytree(older, older.with_name(f"an-older-{older.name}"))
    assert main(["study", "run", "seeds=2", "epochs=1", "data.split_seed=7,0"]) == 0
    told = capsys.readouterr()
    assert told.err.count("(6 of 6 trainings recorded already)") == 2
    assert "on 2 data sets" in " ".join(told.out.split())
    assert "split_seed=7" in told.out
    before = list(here.glob("run/studies/*"))
    assert main(["study", "run", "seeds=3", "epochs=1", "data.split_seed=1,-1"]) == 2
    assert "data.split_seed" in capsys.readouterr().err
    assert list(here.glob("run/studies/*")) == before


@pytest.mark.room("simulator", "tacverse")
@pytest.mark.slow
def test_sensors_are_studied_within_and_each_left_out(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Simulated sensors that differ in gel, and files in the release's layout; each protocol has a table of its own."""
    from tacevo.data.simulator.written_files import write_files

    source = simulated(images=40, image_size=16, seed=5)
    for sensor in ("A", "B"):
        folder = here / "own" / "Force_Regression" / sensor
        write_files(source, folder, workers=1)
        rows = (folder / "labels.csv").read_text().replace("image,Fx,Fy,Fz", "image_name,fx,fy,fz")
        (folder / f"{sensor}.csv").write_text(rows)
    usual = ["study", "run", "seeds=2", "epochs=1"]
    assert main([*usual, "data.gel_mm=0,2"]) == 0
    assert "gel_mm=2.0" in capsys.readouterr().out
    left_out = ["data=tacverse", "data.root=own", "data.sensor=A+B", "data.test_sensor=A,B"]
    assert main([*usual, *left_out]) == 0
    told = capsys.readouterr().out
    assert all(words in told for words in ("test_sensor=A", "test_sensor=B"))
    assert "gel_mm=2.0" not in told
    recorded = [study.read().data for study in studies_of(Path("run"))]
    assert {("data.gel_mm=2.0",), ("data.test_sensor=A",), ("data.test_sensor=B",)} <= {
        data.selected for data in recorded
    }
    assert sorted(data.counts for data in recorded)[:2] == [(24, 8, 8)] * 2


@pytest.mark.slow
def test_several_sensors_are_studied_by_one_command(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Given networks are recorded on the first sensor and studied on each; simulated ones make no matrix."""
    usual = [word for word in GIVEN if word != "run.dir=run"]
    pairs = ["data.sensor=ViTacTip,ViTac", "run.dir=pairs"]
    assert main(["study", *usual, *pairs]) == 0
    told = capsys.readouterr().out
    assert told.count("study of ") == 2
    assert "on 2 data sets" in told
    assert "test_sensor" not in told  # which simulated data does not have
    assert not [table for table in open_run("pairs").tables if table.endswith("/transfer_sensors")]
    assert open_run("pairs").config.data.sensor == "ViTacTip"
    assert main(["study", *usual, *pairs]) == 0
    assert capsys.readouterr().err.count("trainings recorded already") == 2


def test_trainings_of_the_run_are_told_before_them(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Their epochs are not the study's, and a study of one epoch may take most of its time for them."""
    settings = [word for word in GIVEN if word not in {"run.dir=run", "epochs=1"}]
    assert main(["study", *settings, "epochs=1", "training.epochs=2", "run.dir=longer"]) == 0
    told = capfd.readouterr().err
    assert "training.epochs=2" in told
    assert told.index("training.epochs=2") < told.index("generation 0")


def test_mistake_in_a_later_sensor_is_found_before_the_first_is_trained(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a sensor that is not simulated; nothing is recorded."""
    usual = [word for word in GIVEN if word != "run.dir=run"]
    assert main(["study", *usual, "data.sensor=ViTacTip,Other", "run.dir=pairs"]) == 2
    assert "data.sensor" in capsys.readouterr().err
    assert not Path("pairs").exists()


def test_shots_of_no_tested_sensor_are_refused(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As a search refuses them, and not dropped; nothing is recorded."""
    usual = [word for word in GIVEN if word != "run.dir=run"]
    assert main(["study", *usual, "data.shots=5", "run.dir=shots"]) == 2
    assert "data.shots" in capsys.readouterr().err
    assert not Path("shots").exists()


def test_study_that_was_begun_under_its_earlier_name_is_continued(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Given networks were called elites once; such a study is found, replayed and not made twice."""
    now = study_on("").path
    assert now.name.startswith("networks2-seeds2-epochs1-")
    earlier = now.rename(now.with_name(now.name.replace("networks", "elites")))
    record = json.loads((earlier / "study.json").read_text())
    (earlier / "study.json").write_text(json.dumps({**record, "name": earlier.name}))
    assert main(["study", *GIVEN]) == 0
    assert f"{earlier.name} (6 trainings, 6 of them recorded already)" in capsys.readouterr().out
    assert not now.exists()
    assert main(["replay", "run"]) == 0


def test_name_says_which_sensor_and_shots(here: Path) -> None:
    """Behind other settings, too; the shorter name of earlier releases is looked for after it."""
    header = StudyDirectory(study_on("").path).read_finished().header
    other = (("sensor", "TacTip+ViTac+ViTacTip"), ("shots", 10), ("test_sensor", "TacTip"), ("split_seed", 7))
    now, earlier, *_ = study_names(replace(header, other_data=other), searched=True)
    assert "shots-10-test_sensor-TacTip" in now
    assert now.startswith(earlier[: -len("-01234567")])
    assert len(study_names(header, searched=True)) == 1  # on the run's own data there is nothing to cut


def test_replay_compares_run_and_both_studies_without_data(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the stores alone, without the files that were given."""
    shutil.rmtree("cache/data")
    for file in here.glob("*.py"):
        file.unlink()
    assert main(["replay", "run"]) == 0
    assert capsys.readouterr().out.count("every score is as recorded") == 2


@pytest.mark.slow
def test_published_run_of_given_networks_is_verified(here: Path) -> None:
    """One file holds networks, studies and tables; it says that no model was asked."""
    publish("run", "-o", "given.zip", "--author", "A. Nyone")
    assert main(["replay", "given.zip"]) == 0
    assert main(["tables", "given.zip", "-o", "tables"]) == 0  # two seeds are too few for verdicts, which a remark says
    assert "split_seed=7" in "".join(path.read_text() for path in Path("tables").rglob("transfer.md"))
    readme = zipfile.ZipFile("given.zip").read("README.md").decode()
    assert "No model was asked: the networks were given." in " ".join(readme.split())


@pytest.mark.parametrize(
    ("edit", "error"),
    [
        (lambda record: record.update(other_data=[]), DivergenceError),
        (lambda record: record.update(other_data=[["split_seed", 8]]), DivergenceError),
        (lambda record: record["data"].update(fingerprint="0" * 64), CacheMissError),
    ],
)
def test_edited_data_of_a_study_are_found(edit: object, error: type[TacevoError], here: Path) -> None:
    """A study cannot be moved to other data, or made that of the run's, by its description."""
    directory = study_on("split_seed=7")
    record = json.loads((directory.path / "study.json").read_text())
    edit(record)  # type: ignore[operator]
    (directory.path / "study.json").write_text(json.dumps(record))
    with refused(error):
        replay_studies(read_run(Path("run")), Progress())


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("source", "where", "got"),
    [
        ("class Other: pass\n", "networks, bad.py", "extract, no_class"),
        (NETWORK.format(2, 2).replace("import torch\n", "import torch\nimport os\n"), "networks, bad.py", "policy"),
        pytest.param(NETWORK.format(2, 3), "networks, bad.py", "probe, forward_failed", marks=pytest.mark.slow),
        pytest.param(
            f"<<<<<<< ours\n{NETWORK.format(4, 4)}=======\n{NETWORK.format(5, 5)}>>>>>>> theirs\n",
            "networks, bad.py",
            "expected Python as a whole",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            f"from torch.nn import *\n{NETWORK.format(4, 4)}",
            "networks, bad.py",
            "expected a network that the gate takes as it is",
            marks=pytest.mark.slow,
        ),
        (f"# My own.\n{NETWORK.format(8, 8)}", "networks", "wide and bad are one"),
    ],
)
def test_bad_network_is_refused_before_anything_is_trained(
    source: str, where: str, got: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error names the file and the gate's reason, and the good ones are kept."""
    Path("bad.py").write_text(source)
    evaluations = len(list(here.glob("cache/evaluations/*/*")))
    assert main(["study", "networks=[wide.py,bad.py]", *SETTINGS[:-2], "run.dir=other", "store.root=cache"]) == 2
    error = capsys.readouterr().err
    assert where in error
    assert got in error
    assert not Path("other").exists()
    assert len(list(here.glob("cache/evaluations/*/*"))) == evaluations


def test_sources_without_a_syntax_tree_are_compared_as_they_are() -> None:
    """A baseline that is not Python, which the run's gate refuses later, and a sum that is too deep to write."""
    deep = f"SUM = 1{' + 1' * 1_500}\n"
    with refused(ConfigError, place="networks", got="one and other are one"):
        _check_different(replace(TASK, baseline="("), [Given(name=name, source=deep) for name in ("one", "other")])


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["run=run", "data=numpy", "data.root=two.npz"], "task.outputs: expected 2, as the data set has (a, b); got 3"),
        (["run=run", "data=numpy", "data.root=classes.npz"], "task.kind: expected classification"),
        (["run=run", "data.image_size=16"], "data.image_size: expected 32, which the run's networks are for; got 16"),
        (["run=run", "elites=1"], "elites: expected no choice of elites"),
        (["run=run", "choose=reestimated"], "choose: expected no choice of elites"),
        (["run=run", "networks=wide.py"], "networks"),
        (["run=run", "task=grating"], "task: not a setting"),
        (UNNAMED, "task: expected the task of the networks; got no task; add it, as in task=force"),
        ([*UNNAMED, "task.outputs=2"], "task: expected the task of the networks"),
    ],
)
def test_data_that_do_not_fit_are_refused(
    settings: list[str], message: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And nothing is begun."""
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (40, 32, 32, 3), dtype=np.uint8)
    np.savez("two.npz", images=images, labels=rng.random((40, 2)), names=["a", "b"])
    np.savez("classes.npz", images=images, labels=np.arange(40) % 3)
    assert main(["study", *settings]) == 2
    assert message in capsys.readouterr().err
    assert len(studies_of(Path("run"))) == 2


def test_run_of_given_networks_is_not_continued(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nobody chose who would answer; it stays a run that did not search."""
    assert main(["extend", "run", "--store", "cache", "search.generations=1", "run.dir=mine"]) == 2
    assert "run: expected a run that searches" in capsys.readouterr().err
    assert not Path("mine").exists()
