"""The settings of a run reach their source, and data that do not suit the task are refused before they are decoded."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refused
from small_recordings import save_arrays, save_folder, save_forces, save_gratings, save_table

from tacevo.choices import Confinement, GratingClasses
from tacevo.config.compose import compose
from tacevo.config.plain import from_plain
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.data.dataset import Dataset
from tacevo.environment import gpus
from tacevo.errors import ConfigError, DataError, SandboxError
from tacevo.llm.recording import RecordingLLM
from tacevo.profile import Admitted
from tacevo.records import Completion, Mode, Reason, Request, to_json, written
from tacevo.rules import CURRENT, STUDY, TRAININGS_OF_STUDIES
from tacevo.runs.datasets import load_data, source_of
from tacevo.runs.progress import Progress
from tacevo.runs.providers import check_temperature, provider_settings
from tacevo.runs.wiring import Workbench, recipe_of
from tacevo.sandbox.client import Died
from tacevo.sandbox.confinement import available, report
from tacevo.storage.store import Store
from tacevo.training.memory import predicted_mib


def load(tmp_path: Path, *overrides: str) -> Dataset:
    """Load what lies in the directory `recording` with small images."""
    settings = [f"data.root={tmp_path / 'recording'}", f"store.root={tmp_path / 'cache'}", "data.image_size=16"]
    return load_data(compose([*settings, *overrides]), Progress())


def rows_of(name: str, values: int, *, count: int = 20) -> str:
    """Write rows of a table, each label different."""
    numbers = [[(row * step) % count for step in (1, 3, 7)[:values]] for row in range(count)]
    return "".join(f"{name.format(row)},{','.join(map(str, labels))}\n" for row, labels in enumerate(numbers))


def test_every_setting_of_a_table_arrives(tmp_path: Path) -> None:
    """Table, columns and the leave to skip come from the configuration."""
    save_table(tmp_path / "recording", rows_of("{}.png", 3), images=15, header="picture,a,b,c\n")
    (tmp_path / "recording" / "labels.csv").rename(tmp_path / "recording" / "forces.csv")
    dataset = load(
        tmp_path,
        "data=csv",
        "data.table=forces.csv",
        "data.image_column=picture",
        "data.target_columns=[c,a,b]",
        "data.skip_missing=true",
    )
    assert dataset.facts.names == ("c", "a", "b")
    assert sum(dataset.facts.counts) == 15


@pytest.mark.room("tacverse")
def test_release_is_loaded_by_its_own_split(tmp_path: Path) -> None:
    """`data=tacverse` alone reads the forces of the ViTacTip, 60/20/20 in their order."""
    save_forces(tmp_path / "recording", rows_of("image_{}.png", 3), images=20)
    dataset = load(tmp_path, "data=tacverse")
    assert dataset.facts.names == ("Fx", "Fy", "Fz")
    assert dataset.validation.tolist() == [12, 13, 14, 15]


@pytest.mark.room("tacverse")
def test_sensor_and_pattern_of_a_release_arrive(tmp_path: Path) -> None:
    """Both are directories; the classes are the sizes below them."""
    save_gratings(tmp_path / "recording", *(f"{size}_{press}.png" for size in (0.5, 1.5) for press in range(10)))
    parent = tmp_path / "recording" / "Grating_Classification"
    (parent / "ViTacTip" / "Blackdot").rename(parent / "ViTacTip" / "Tran")
    (parent / "ViTacTip").rename(parent / "TacTip")
    overrides = ["data=tacverse", "task=grating", "task.outputs=2", "data.sensor=TacTip", "data.pattern=Tran"]
    assert load(tmp_path, *overrides).facts.names == ("0.5 mm", "1.5 mm")


@pytest.mark.room("tacverse")
def test_settings_of_a_release_select_but_in_runs_of_before(tmp_path: Path) -> None:
    """An older run.json has spacings and images without effect, and lacks what came later: it reads all, as it did."""
    from tacevo.data.sources.tacverse import TacVerse

    chosen = ["data.pattern=Blackdot", "data.spacings_mm=[0.5,1.5]", "data.images=15", "data.classes=joint"]
    config = compose(["data=tacverse", "task=grating", "data.root=x", *chosen])
    source = source_of(config)
    assert isinstance(source, TacVerse)
    assert (source.spacings_mm, source.images, source.classes) == ((0.5, 1.5), 15, GratingClasses.joint)
    later = {"select", "classes", "test_sensor", "shots"}
    plain = to_json(config)
    plain["data"] = {name: value for name, value in to_json(config.data).items() if name not in later}
    older = from_plain(plain)
    assert source_of(older) == replace(source, spacings_mm=(), images=None, classes=GratingClasses.size)
    assert written(older.data).keys() & later == set()


@pytest.mark.parametrize(
    ("labels", "task"), [(np.arange(12) % 3, "force"), (np.arange(36.0).reshape(12, 3), "grating")]
)
def test_archive_is_loaded_as_the_kind_that_its_labels_are(tmp_path: Path, labels: NDArray[Any], task: str) -> None:
    """`data=numpy` reads the file that `data.root` names. Integers are not forces, and floats are not classes."""
    save_arrays(tmp_path / "recording", labels=labels)
    (tmp_path / "recording.npz").rename(tmp_path / "recording")
    with refused(ConfigError, place="task.kind", remedy="data=numpy for what the type of its labels says"):
        load(tmp_path, "data=numpy", f"task={task}")
    if task == "grating":
        assert load(tmp_path, "data=numpy").facts.counts == (10, 1, 1)


@pytest.mark.room("tacverse", "simulator")
@pytest.mark.parametrize("overrides", [["data=simulated"], ["data=tacverse", "data.root=recording"]])
def test_task_that_a_source_does_not_know_is_refused(overrides: list[str]) -> None:
    """The message lists the tasks that it knows."""
    place, expected = overrides[0], "one of force, grating, hardness"
    with refused(ConfigError, place=place, expected=expected, got="pose"):
        source_of(compose([*overrides, "task.name=pose"]))


def cut_all_images(folder: Path) -> None:
    """Leave only the headers of images, so that any decoding fails."""
    for path in folder.rglob("*.png"):
        path.write_bytes(path.read_bytes()[:45])


def test_data_that_do_not_suit_the_task_are_refused_before_decoding(tmp_path: Path) -> None:
    """No image can be decoded, but what is told is the number of outputs or the kind of the labels."""
    save_folder(tmp_path / "recording", *(f"{number % 2}/{number}.png" for number in range(40)))
    cut_all_images(tmp_path / "recording")
    with refused(ConfigError, place="task.outputs", expected="2, as the data set has (0, 1)", got="7"):
        load(tmp_path, "data=folder", "task=grating")
    with refused(ConfigError, place="task.kind", expected="classification", got="regression"):
        load(tmp_path, "data=folder", "task=force")
    with refused(DataError, got="some images cannot be read (40 found)"):
        load(tmp_path, "data=folder", "task=grating", "task.outputs=2")


#: A search on a GPU, as far as this machine can have one.
ON_A_GPU = ["training.device=cuda", "training.gpu=NVIDIA H200", "sandbox.require=none", "numerics=fast"]


def bench(tmp_path: Path, *overrides: str, mode: Mode = Mode.record, **parts: Any) -> Workbench:
    """Return the workbench of a search without data."""
    config = compose([f"store.root={tmp_path}/store", "archive.samples=100", *overrides])
    facts = facts_without_data(config)
    return Workbench(config, load_task(config, facts), facts, mode, **parts)


@pytest.mark.slow
def test_memory_is_predicted_from_the_probe_that_is_recorded(tmp_path: Path) -> None:
    """Of a network without one nothing is predicted, and none is made for it."""
    with bench(tmp_path, *ON_A_GPU) as opened:
        recipe = written(recipe_of(opened.config))
        header = {"source": opened.task.baseline, "recipe": recipe, "train": 100, "validation": 10}
        opened.gate(CURRENT)
        assert opened._predicted(header) is None
        probed = opened.gate(CURRENT).inspect(opened.task.baseline)
        assert isinstance(probed, Admitted)
        expected = predicted_mib(probed.profile, opened.task.contract, recipe_of(opened.config), 110)
        assert opened._predicted(header) == expected
        assert expected is not None
        assert opened._predicted({**header, "source": "class Net: pass"}) is None


@pytest.mark.slow
def test_probe_beside_a_walled_gpu_has_the_walls_of_a_cpu(tmp_path: Path) -> None:
    """No door is open to what does not compute there."""
    told: list[Mapping[str, str]] = []
    walled = [*ON_A_GPU[:2], "sandbox.require=kernel", "numerics=fast"]
    with bench(tmp_path, *walled, notice=told.append) as opened:
        opened.gate(CURRENT).inspect(opened.task.baseline)
    assert told == [{**report(), "level": available()}]


@pytest.mark.slow
def test_run_is_told_what_holds_its_candidates(tmp_path: Path) -> None:
    """On a GPU the walls are left out, which is told as it is; a search on a CPU tells those of the machine."""
    told: list[Mapping[str, str]] = []
    with bench(tmp_path, *ON_A_GPU, notice=told.append) as opened:
        opened.gate(CURRENT).inspect(opened.task.baseline)
    assert [measures["level"] for measures in told] == [Confinement.none]


@pytest.mark.room("estimate", "gpus")
@pytest.mark.few(1)
@pytest.mark.parametrize(("visible", "said"), [("", "a machine without one"), ("0", "equipped or confined")])
def test_gpu_that_fails_is_no_verdict(visible: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a GPU, or with a torch without CUDA, no candidate is rejected: the search stops, and stores nothing."""
    from tacevo.runs.pace import noise

    if gpus():
        pytest.skip("there is a GPU")
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    with bench(tmp_path, "data.image_size=16", *ON_A_GPU) as opened:
        opened.data = noise(opened.config, tmp_path)
        with refused(SandboxError, got=said):
            opened.evaluator(CURRENT).evaluate(opened.task.baseline, 0)
    assert not (tmp_path / "store").exists()


def test_model_is_not_built_in_a_replay_nor_twice_in_a_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stores answer a replay, which needs no key of a provider; a search uses the model that was checked for it."""
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    openai = ["llm=openai", "llm.model=m"]
    with bench(tmp_path, *openai, mode=Mode.replay) as opened:
        assert isinstance(opened.effects(CURRENT).llm, RecordingLLM)
    with pytest.raises(ConfigError), bench(tmp_path, *openai) as opened:
        opened.effects(CURRENT)
    given = RecordingLLM(None, Store(tmp_path, "completions"))
    with bench(tmp_path, *openai, llm=given) as opened:
        assert opened.effects(CURRENT).llm is given
        assert opened.effects(replace(CURRENT, static=0)).llm is not given  # under other rules, stores answer all


def test_nothing_runs_a_candidate_in_a_replay(tmp_path: Path) -> None:
    """Whatever would ask for it: the stores answer."""
    with bench(tmp_path, mode=Mode.replay) as opened:
        gate = opened.gate(CURRENT)
        with refused(SandboxError, expected="a replay that runs no candidate", got="(probe)"):
            gate.run("probe", {}, b"", gate.probe_limits)


@pytest.mark.room("grammar")
def test_grammar_has_one_model(tmp_path: Path) -> None:
    """Another name would stand in records as if another model had answered."""
    expected = "grammar-2 for llm=grammar"
    with (
        refused(ConfigError, place="llm.model", got="'claude'", expected=expected),
        bench(tmp_path, "llm=grammar", "llm.model=claude") as opened,
    ):
        opened.effects(CURRENT)


@pytest.mark.few(1)
@pytest.mark.parametrize("other", ["llm.thinking_tokens=null", "llm.max_tokens=2048", "llm.model=another"])
def test_refusal_of_a_temperature_is_of_one_choice_of_model(tmp_path: Path, other: str) -> None:
    """A model that refuses a temperature beside thinking may take it without, so no other choice is refused."""
    chosen = [f"store.root={tmp_path}", "llm=anthropic", "llm.thinking_tokens=1024"]
    config = compose(chosen)
    request = Request(
        model=config.llm.model,
        system="",
        messages=(),
        temperature=0.5,
        max_tokens=config.llm.max_tokens,
        draw=0,
        settings=provider_settings(config.llm),
    )
    completion = Completion(
        text="x", model="m", stop_reason="end_turn", input_tokens=1, output_tokens=1, dropped=("temperature",)
    )
    Store(tmp_path, "completions").write(to_json(request), to_json(completion))
    arm = ["ablation=fixed_temperature"]
    with refused(ConfigError, got="refuses temperatures"):
        check_temperature(arm, config)
    check_temperature(arm, compose([*chosen, other]))


def test_layout_and_functions_follow_the_rules_of_a_training(tmp_path: Path) -> None:
    """Those of a search, and those of a study, whose numbers stand for numbers of training."""
    save_arrays(tmp_path / "recording", labels=np.arange(36.0).reshape(12, 3))
    settings = [f"data.root={tmp_path / 'recording.npz'}", f"store.root={tmp_path / 'cache'}", "data.image_size=16"]
    config = compose([*settings, "data=numpy", "task=force"])
    data, sent = load_data(config, Progress()), []

    def run(entry: str, header: Any, payload: bytes, *_: object) -> Died:
        sent.append((header.get("contiguous", False), header.get("mkl_functions", False)))
        return Died(Reason.crashed, "a fake")

    with Workbench(config, load_task(config, data.facts), data.facts, Mode.record, data=data, run=run) as bench:
        for rules, training in TRAININGS_OF_STUDIES.items():
            bench.studies(rules, data.scale).retrain("source", 1)
            bench.weigh("source", 1, 1, training)
    assert sent == [(True, True)] * 4 + [(False, True)] * 6 + [(False, False)] * 2
    assert STUDY in TRAININGS_OF_STUDIES
