"""Promise: a study of given networks is composed of the files that were named, and of settings that belong to it."""

from dataclasses import replace
from pathlib import Path

import pytest
from fakes import TASK
from refusals import refused
from smallest import SMALLEST

from tacevo.choices import Device, Numerics, Precision, SplitRule
from tacevo.config.compose import compose, compose_elsewhere
from tacevo.config.conf_folder import conf_root
from tacevo.config.given import compose_given, gives_networks
from tacevo.config.identity import task_hash
from tacevo.errors import ConfigError
from tacevo.records import Given, to_json
from tacevo.results.publishable import other_device
from tacevo.runs.wiring import check_means, recipe_of, trained_by
from tacevo.storage.canonical import content_hash


def networks(*names: str, folder: Path = Path()) -> None:
    """Write files that need not be networks yet: the gate comes later."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("class Net: pass\n")


def named(*given: str) -> list[str]:
    """Name the networks of a study."""
    return [file.name for file in compose_given([f"networks=[{','.join(given)}]", "task=force"])[2].values()]


@pytest.mark.parametrize(
    ("overrides", "gives"),
    [
        (["networks=a.py", "task=force"], True),
        (["task=hardness"], True),
        (["experiment=demo", "seeds=3"], True),
        (["run=runs/a", "data.split_seed=7"], False),
        (["run=runs/a", "networks=a.py"], False),
        (["seeds=3"], False),
        ([], False),
    ],
)
def test_networks_are_given_where_no_run_is_named(overrides: list[str], gives: bool) -> None:
    """Files, or a task whose baseline stands alone."""
    assert gives_networks(overrides) == gives


def test_run_of_given_networks_keeps_all_of_them(place: Path) -> None:
    """One generation, places for the baseline and each file, and nobody to ask; settings reach study and run."""
    networks("a.py", "b.py")
    settings = ["seeds=5", "epochs=3", "seed=4", "data.images=40", "store.root=other", "run.dir=here"]
    study, run, files = compose_given(["networks=[a.py,b.py]", "task=force", *settings])
    assert (study.run, study.seeds, study.epochs, study.store.root) == (None, 5, 3, "other")
    assert (run.seed, run.data.images, run.store.root, run.run.dir) == (4, 40, "other", "here")
    assert (run.search.generations, run.search.initial) == (0, 2)
    assert (run.archive.kind, run.archive.kept, run.prompts.policy) == ("best", 3, "none")
    assert [(file.name, file.source) for file in files.values()] == [
        ("a", "class Net: pass\n"),
        ("b", "class Net: pass\n"),
    ]


def test_baseline_alone_is_a_run_of_one() -> None:
    """A task without files."""
    study, run, files = compose_given(["task=hardness"])
    assert (study.networks, files, run.search.initial, run.archive.kept) == ((), {}, 0, 1)


def test_experiment_that_wants_a_model_is_not_asked_for_one() -> None:
    """It is named for its data and its training."""
    assert compose_given(["experiment=paper_force"])[1].data.images == 3000


def test_files_are_found_by_name_directory_and_pattern(place: Path) -> None:
    """In the order in which they were named, those of a directory or a pattern by name."""
    networks("z.py", "nets/b.py", "nets/a.py", "nets/c.txt", "pa/t1.py", "pa/t2.py")
    assert named("z.py", "nets", "'pa/t*.py'") == ["z", "a", "b", "t1", "t2"]
    assert named("nets/c.txt") == ["c"]
    assert named(f"'{place}/pa/*'") == ["t1", "t2"]


@pytest.mark.few(1)
@pytest.mark.parametrize("task", ["force", "grating"])
def test_shipped_networks_are_found_from_anywhere(task: str, place: Path) -> None:
    """The four published variants of a task, in conf/."""
    assert named(f"library/{task}/published") == ["variant1", "variant2", "variant3", "variant4"]
    (first, *_) = compose_given([f"networks=library/{task}/published/variant2.py", f"task={task}"])[2].values()
    assert first.source == (conf_root() / "library" / task / "published" / "variant2.py").read_text()


def test_brackets_of_a_directory_are_no_pattern(place: Path) -> None:
    """A name that is there is taken as it is."""
    networks("a[1]/n.py")
    assert named("'a[1]'") == ["n"]


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("given", "where", "expected"),
    [
        ("gone.py", "networks", "a file of a network, a directory of .py files, or a pattern"),
        ("empty", "networks", "a file of a network, a directory of .py files, or a pattern"),
        ("[a.py,more/a.py]", "networks", "files of different names"),
        ("[a.py,a.py]", "networks", "files of different names"),
        ("baseline.py", "networks", "files of different names"),
        ("bytes.py", "networks, bytes.py", "text in UTF-8"),
        ("'odd#name.py'", "networks, odd#name.py", "a file name of up to 40 letters"),
        ("''", "networks.0", "text that is not empty"),
        ("5", "networks", "a list"),
    ],
)
def test_files_that_are_not_networks_of_their_own_name_are_refused(
    given: str, where: str, expected: str, place: Path
) -> None:
    """The error says which; two files of one name would be one row of a table."""
    networks("a.py", "more/a.py", "baseline.py", "odd#name.py")
    Path("empty").mkdir()
    Path("bytes.py").write_bytes(b"\xff\xfe")
    with refused(ConfigError, place=where, expected=expected):
        compose_given([f"networks={given}", "task=force"])


@pytest.mark.parametrize(
    "override", ["search.generations=3", "llm=anthropic", "archive.niches=5", "ablation=none", "x=1"]
)
def test_settings_of_a_search_are_refused(override: str) -> None:
    """They would have no effect."""
    with refused(ConfigError, place=override.partition("=")[0], expected="a setting of a study, or of its run"):
        compose_given(["task=force", override])


@pytest.mark.parametrize("override", ["elites=2", "choose=fitness"])
def test_given_networks_are_not_chosen_among(override: str) -> None:
    """All of them are studied."""
    with refused(ConfigError, place=override.partition("=")[0], expected="every given network is studied"):
        compose_given(["task=force", override])


def test_task_without_given_networks_keeps_its_hash() -> None:
    """That of the ledgers that were written before there were any; a name or a source makes another run."""
    before = {name: value for name, value in to_json(TASK).items() if name != "given"}
    assert task_hash(TASK) == content_hash(before)
    tasks = [replace(TASK, given=(Given(name=name, source=source),)) for name, source in ("ab", "ac", "db")]
    assert len({task_hash(task) for task in (TASK, *tasks)}) == 4


@pytest.mark.slow
def test_other_data_differ_in_what_was_set_only() -> None:
    """A split, a sensor or a light: everything else is the run's, whatever today's defaults are."""
    run = compose([*SMALLEST, "data.split_seed=1"])
    assert (
        compose_elsewhere(run, ["data.light=dim", "data.sensor_seed=3"]).data
        == compose([*SMALLEST, "data.split_seed=1", "data.light=dim", "data.sensor_seed=3"]).data
    )
    assert compose_elsewhere(run, ["data.split_seed=7"]).training == run.training
    assert compose_elsewhere(run, ["data.test_part=0.3"]).data == replace(run.data, test_part=0.3)


GPU = ["training.device=cuda", "training.gpu=NVIDIA H200", "numerics=fast", "sandbox.require=none"]


@pytest.mark.slow
def test_other_device_brings_its_own_settings() -> None:
    """From a CPU to a GPU and back, and from GPU to GPU; all else is the run's."""
    cpu = compose([*SMALLEST, "training.epochs=3"])
    on_gpu = compose_elsewhere(cpu, [*GPU, "training.precision=tf32", "data.split_seed=7"])
    whole = compose([*SMALLEST, "training.epochs=3", *GPU, "training.precision=tf32", "data.split_seed=7"])
    assert on_gpu == replace(whole, executor=cpu.executor)  # which is a command's own
    for same in ([], ["training.device=cuda"]):
        other = compose_elsewhere(on_gpu, [*same, "training.gpu=NVIDIA A100"]).training
        assert (other.gpu, other.precision) == ("NVIDIA A100", Precision.tf32)
    several = replace(cpu, executor=replace(cpu.executor, per_gpu=4))
    assert compose_elsewhere(several, ["data.split_seed=7", *GPU]).data.split_seed == 7
    back = ["training.device=cpu", "numerics=portable", "sandbox.require=process", "data.split_seed=0"]
    assert compose_elsewhere(on_gpu, back) == cpu
    assert other_device(cpu, on_gpu) == (
        ("numerics", "fast"),
        ("training.device", "cuda"),
        ("training.gpu", "NVIDIA H200"),
        ("training.precision", "tf32"),
    )
    walled = trained_by(cpu, recipe_of(on_gpu), Numerics.fast, Device.cuda)
    assert walled == replace(on_gpu, data=cpu.data, sandbox=cpu.sandbox)
    with refused(ConfigError, place="sandbox.require"):  # only who types it takes the walls down
        check_means(walled)


@pytest.mark.few(1)
@pytest.mark.parametrize("setting", ["training.batch_size=7", "training.fitness=lowest", "seed=3", "store.root=x"])
def test_other_settings_of_a_run_stay(setting: str) -> None:
    """A study with another batch size would count for its sweep, and could not be replayed."""
    with refused(ConfigError, place=setting.partition("=")[0], got=setting):
        compose_elsewhere(compose(SMALLEST), [setting])


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("overrides", "where"),
    [
        (GPU[:3], "sandbox.require"),
        (GPU[1:], "training.gpu"),
        ([GPU[0], *GPU[2:]], "training.gpu"),
        ([*GPU[:2], GPU[3]], "numerics.kind"),
    ],
)
def test_part_of_a_device_is_refused(overrides: list[str], where: str) -> None:
    """Before anything is trained."""
    with refused(ConfigError, place=where):
        compose_elsewhere(compose(SMALLEST), overrides)


@pytest.mark.slow
def test_recordings_keep_the_size_of_the_runs_images() -> None:
    """Another source brings itself and its split, with the parts of it."""
    run = compose([*SMALLEST, "data.normalisation=unit", "data.test_part=0.7"])
    assert compose_elsewhere(run, ["data=csv", "data.root=mine", "data.target_columns=[a,b,c]"]).data.test_part == 0.1
    other = compose_elsewhere(run, ["data=tacverse", "data.root=somewhere"]).data
    assert (other.source, other.split, other.root) == ("tacverse", SplitRule.release, "somewhere")
    assert (other.image_size, other.normalisation) == (run.data.image_size, run.data.normalisation)


@pytest.mark.few(1)
@pytest.mark.parametrize("overrides", [["data.split_seed=7"], ["data=folder", "data.root=mine"]])
def test_recorded_text_is_not_resolved(overrides: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """A stranger's run.json cannot read the environment into a study, which is published; odd paths are only paths."""
    monkeypatch.setenv("TACEVO_SECRET", "s3cr3t")
    run = compose(SMALLEST)
    data = replace(run.data, root="/mnt/a${b}/set", table="${oc.env:TACEVO_SECRET}", image_column="${seed}")
    theirs = replace(run, data=data, task=replace(run.task, system="${oc.env:TACEVO_SECRET}"))
    composed = compose_elsewhere(theirs, overrides)
    assert (composed.data.table, composed.data.image_column) == (data.table, data.image_column)
    assert composed.data.root == ("mine" if "data.root=mine" in overrides else data.root)
    assert composed.task == theirs.task


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("override", "where", "expected", "remedy"),
    [
        ("data.split_sed=7", "data.split_sed", "", "did you mean data.split_seed?"),
        ("data.image_size=64", "data.image_size", "32, which the run's networks are for", ""),
        ("data=tacverse", "data.root", "the directory of the data set", ""),
    ],
)
def test_wrong_setting_of_other_data_is_refused(override: str, where: str, expected: str, remedy: str) -> None:
    """As the user wrote it."""
    with refused(ConfigError, place=where, expected=expected, remedy=remedy):
        compose_elsewhere(compose(SMALLEST), [override])
