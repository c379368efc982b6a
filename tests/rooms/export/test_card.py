"""Promise: the card and config.json say what the files are, in YAML, Markdown and programs that hold for any name."""

import io
import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from checkout import ROOT
from jsonschema import ValidationError, validate
from PIL import Image
from refusals import refused
from rendered import HOSTILE, meant, skeleton
from rich.console import Console

import tacevo
from tacevo.data.dataset import Dataset
from tacevo.data.sources.image_files import decode
from tacevo.errors import RunError
from tacevo.export import directory
from tacevo.export.card import agreement, card
from tacevo.export.contents import Exported, config_of, latency_of, run_of
from tacevo.export.conversion import Built, Converted
from tacevo.export.trainings import ExportSettings, Like, Trained, design
from tacevo.parts.source import Catalogue
from tacevo.records import Kind, Reason, Training
from tacevo.runs.datasets import load_same, source_of
from tacevo.runs.progress import Progress
from tacevo.sandbox.client import Died, Finished, Frame
from tacevo.training.weights import Weighed

#: Of a run, a task and an output.
ODD = 'a: "b" | c`<d>\n- e: [f'

CLASSES = ("0.35 mm", ODD, "3: [")


def trained(predictions: Any, *, was_recorded: bool = True, differing: Sequence[str] | None = ()) -> Trained:
    """Make a training that predicts so."""
    digest = "0" * 64
    training = Training(train_losses=(1.0,), validation_losses=(1.0,), predictions_sha256=digest, weights_sha256=digest)
    weighed = Weighed(training=training, tested=training, weights={}, predictions=predictions)
    told = None if differing is None else tuple(differing)
    return Trained(weighed=weighed, seed=1, epoch=1, key=digest, was_recorded=was_recorded, differing=told)


def exported(run: tacevo.Run, data: Dataset, catalogue: Catalogue, **settings: Any) -> Exported:
    """Make a network on its way out, without a training: its predictions are drawn."""
    recorded = run.recorded
    line = next(line for line in recorded.candidates if line.id == run.elites["id"].iloc[0])
    given = ExportSettings(**settings)
    predictions = np.random.default_rng(0).normal(size=(len(data.test), data.facts.outputs)).astype(np.float32)
    times = {"1": [1.0, 2.0], "32": [3.0, 4.0]}
    made = Converted(file=b"", difference=1e-7, milliseconds=times)
    return Exported(
        run=recorded,
        line=line,
        plan=design(recorded, line, given),
        data=data,
        catalogue=catalogue,
        trained=[trained(predictions)],
        doubts=(),
        settings=given,
        bundle=None,
        built=Built(arguments=("in_channels",), difference=1e-7),
        onnx=made,
    )


@pytest.fixture(scope="module")
def of_forces(published: Path, tmp_path_factory: pytest.TempPathFactory) -> Exported:
    """Return a network of the session's run, in a directory of an odd name, with an odd output and no default."""
    path = shutil.copytree(published / "run", tmp_path_factory.mktemp("odd") / ODD)
    run = tacevo.open(path)
    assert isinstance(run, tacevo.Run)
    data = load_same(run.config, run.recorded.facts, Progress(Console(quiet=True)))
    facts = replace(data.facts, names=(ODD, *data.facts.names[1:]))
    catalogue = replace(source_of(run.config).catalogue(), names=facts.names)
    return exported(run, replace(data, facts=facts), catalogue, seeds=1, licence="no")


@pytest.fixture(scope="module")
def of_classes() -> Exported:
    """Return a network of a published run on gratings, with data of three classes and two test images."""
    run = tacevo.open(ROOT / "cache" / "published" / "grating-winners.zip")
    assert isinstance(run, tacevo.Run)
    facts = replace(run.recorded.facts, names=CLASSES, outputs=3, counts=(3, 3, 2))
    rows, classes = np.arange(8), np.arange(8) % 3
    data = Dataset(
        facts=facts,
        images=Path("never"),
        targets=classes,
        train=rows[:3],
        validation=rows[3:6],
        test=rows[6:],
        mean=(1.0,) * 3,
        deviation=(1.0,) * 3,
        offset=(),
        scale=(),
    )
    catalogue = Catalogue(kind=Kind.classification, names=CLASSES, labels=classes, image_size=64, pictures=())
    return exported(run, data, catalogue, like=Like.search)


def head_of(text: str) -> Any:
    """Read what Hugging Face reads."""
    begin, head, _ = text.split("---\n", 2)
    assert begin == ""
    return yaml.safe_load(head)


def test_head_of_the_card_is_yaml_whatever_names_are(of_forces: Exported) -> None:
    """A licence that YAML would read as false stays a text; numbers are numbers."""
    head = head_of(card(of_forces))
    (model,) = head["model-index"]
    (result,) = model["results"]
    assert head["license"] == "no"
    assert model["name"] == f"{ODD}-{of_forces.line.id}"
    assert result["dataset"]["name"] == "force"
    values = {each["type"]: each["value"] for each in result["metrics"]}
    assert values[f"recorded_mae_{ODD}"] == of_forces.metrics[f"recorded_mae_{ODD}"][0]


def test_names_break_no_line_and_no_cell_of_the_card(of_forces: Exported) -> None:
    """Each row of the metrics has three cells; what is no row holds no text of a name alone."""
    body = card(of_forces).split("---\n", 2)[2]
    table = body.partition("| metric | value")[2].partition("\n\n")[0].splitlines()
    assert {len(re.findall(r"(?<!\\)\|", row)) for row in table[1:]} == {4}
    assert not [line for line in body.splitlines() if line.startswith(("- e:", "<d>"))]
    assert "<d>" not in re.sub(r"\\<", "", body)


def said_by(model: Exported, text: str) -> Exported:
    """Return a network of which a stranger said this, wherever the card cites one: without an ONNX file, too."""
    config = model.run.config
    run = replace(model.run, config=replace(config, llm=replace(config.llm, model=text)))
    run.__dict__["name"] = text
    line = replace(model.line, request="0" * 64)
    names = (text, *model.data.facts.names[1:])
    data = replace(model.data, facts=replace(model.data.facts, names=names))
    catalogue = replace(model.catalogue, names=names, units=(text, "N", "N"))
    differing = replace(model.trained[0], differing=("weights_sha256",))
    return replace(
        model,
        run=run,
        line=line,
        data=data,
        catalogue=catalogue,
        trained=[differing],
        doubts=(f"torch {text}",),
        plan=replace(model.plan, uncited=f"the stores lack {text}"),
        onnx=None,
        without_onnx=f"crashed: {text}",
    )


@pytest.mark.parametrize("text", HOSTILE)
def test_text_of_a_stranger_is_text_in_the_card(text: str, of_forces: Exported) -> None:
    """Names, units, the model, versions and reasons; and none of it changes what Hugging Face reads above it."""
    (calm_head, calm), (head, body) = (
        card(said_by(of_forces, said)).removeprefix("---\n").split("\n---\n", 1) for said in ("word", f"x {text} y")
    )
    assert skeleton(body) == skeleton(calm)
    assert meant(body) == meant(calm)
    read, expected = yaml.safe_load(head), yaml.safe_load(calm_head)
    assert read.keys() == expected.keys()
    assert (read["license"], read["tags"]) == (expected["license"], expected["tags"])


@pytest.mark.parametrize("onnx", [True, False])
def test_files_keep_their_schemas(onnx: bool, of_forces: Exported, of_classes: Exported) -> None:
    """Its JSON holds what docs/formats.md says, of both kinds of tasks, with an ONNX file or without."""
    for model in (of_forces, of_classes):
        made = model if onnx else replace(model, onnx=None)
        files = {"config": config_of(made), "run": run_of(made)}
        if made.onnx is not None:
            files["latency"] = latency_of(made, made.onnx)
        for name, value in files.items():
            schema = json.loads((ROOT / f"docs/schemas/export_{name}.json").read_text())
            validate(json.loads(json.dumps(value)), schema)
            with pytest.raises(ValidationError):
                validate({**value, "rules": 1, "weights": 1, "threads": "x"}, schema)


def test_what_onnx_cannot_hold_is_said_and_the_rest_is_written(of_forces: Exported) -> None:
    """The class with its weights is checked all the same; card, config.json and the printed line say why."""
    said = io.StringIO()
    view = Progress(Console(file=said, width=200))

    def run(entry: str, header: Any, payload: bytes, limits: Any, score: Any = None, /) -> Finished | Died:
        if entry == "predict":
            outputs = of_forces.outputs.astype(np.float32).tobytes()
            return Finished((Frame({"arguments": ["in_channels"]}, outputs),))
        return Died(Reason.crashed, "No ONNX function for aten.kthvalue [a](b)")

    model = directory._checked(run, replace(of_forces, built=None, onnx=None), "SOURCE", view)
    files = directory._contents(model, "SOURCE")
    assert files.keys() == {"README.md", "config.json", "run.json", "model.py", "weights.safetensors"}
    assert (files["model.py"], json.loads(files["config.json"])["onnx"]) == (b"SOURCE", None)
    text = files["README.md"].decode()
    assert r"no `model.onnx`: expected a network that can be written so; got crashed: No ONNX function" in text
    assert r"aten.kthvalue \[a\](b)" in text
    assert len(re.findall("```python", text)) == 1
    assert "onnxruntime" not in text
    assert "no model.onnx" in said.getvalue()
    assert "aten.kthvalue" in said.getvalue()


def test_class_that_says_something_else_is_not_exported(of_forces: Exported) -> None:
    """Its weights would not be what was trained."""

    def run(entry: str, header: Any, payload: bytes, limits: Any, score: Any = None, /) -> Finished:
        return Finished((Frame({"arguments": []}, (1.01 * of_forces.outputs).astype(np.float32).tobytes()),))

    with refused(RunError, place="model.py with its weights", got="a difference of"):
        directory._checked(run, of_forces, "SOURCE", Progress(Console(quiet=True)))


def test_weights_are_numbers_alone(of_forces: Exported) -> None:
    """Names, types, shapes and values; a weight that is called as the format calls its notes is refused."""
    weights = {"a.weight": np.ones((2, 3), np.float32), "a.number": np.array(7)}
    file = directory._as_safetensors(weights)
    header = json.loads(file[8 : 8 + int.from_bytes(file[:8], "little")])
    assert header.keys() == weights.keys()
    assert all(sorted(value) == ["data_offsets", "dtype", "shape"] for value in header.values())
    with refused(RunError, got="__metadata__"):
        directory._as_safetensors({"__metadata__": np.ones(1, np.float32)})


@pytest.mark.parametrize("name", ["Net; import os", "class", "Net\nimport os", ""])
def test_class_must_have_a_name_that_a_program_can_have(name: str, of_forces: Exported, place: Path) -> None:
    """It stands in the programs of the card, which a reader runs; before anything is trained."""
    record, line = of_forces.run.record, of_forces.line
    task = replace(record.task, contract=replace(record.task.contract, class_name=name))
    run, view = replace(of_forces.run, record=replace(record, task=task)), Progress(Console(quiet=True))
    with refused(RunError, place="class_name", expected="a name that Python allows"):
        directory.export(run, line, place / "never", ExportSettings(), bundle=None, retrained=False, view=view)


def test_study_that_could_not_be_checked_is_not_cited(of_forces: Exported) -> None:
    """Nor one whose trainings went otherwise now; the card says so, and names no figure of it."""
    assert len(of_forces.plan.scores) > 1
    median = re.compile("run's study found, as median")
    assert median.search(card(of_forces))
    count = len(of_forces.plan.scores)
    assert f"0 of its {count} seeds were trained again here, and the other {count} are the word" in card(of_forces)
    again = replace(of_forces.trained[0], key=of_forces.plan.scores[0].evaluation)
    assert f"1 of its {count} seeds was trained again" in card(replace(of_forces, trained=[again]))
    unchecked = replace(of_forces, plan=replace(of_forces.plan, uncited="the stores lack one"))
    other = replace(of_forces, trained=[replace(of_forces.trained[0], differing=("test_predictions",))])
    for model in (unchecked, other):
        assert not median.search(card(model))
        assert "is not cited" in card(model)


def test_command_of_the_card_has_every_setting(of_forces: Exported) -> None:
    """Those that were given, and those that hold by default."""
    (command,) = re.findall(r"`tacevo export RUN (.*?)`", card(of_forces))
    assert command == f"{of_forces.line.id} -o DIR seeds=1 epochs=1 like=study licence=no"


def test_classes_have_names_probabilities_and_metrics(of_classes: Exported) -> None:
    """The outputs are probabilities in the order of the names; no unit and no scale is told."""
    assert of_classes.outputs.sum(axis=1) == pytest.approx([1, 1])
    assert config_of(of_classes)["outputs"] == {"kind": "classification", "names": list(CLASSES)}
    text = card(of_classes)
    (result,) = head_of(text)["model-index"][0]["results"]
    assert result["task"] == {"type": "image-classification"}
    assert {each["type"] for each in result["metrics"]} == {"accuracy", "macro_f1", "cross_entropy"}
    assert "the probability of each class: 0.35 mm, " in text
    assert "output.argmax()" in text
    assert "recorded_" not in text


def with_groups(model: Exported, groups: Sequence[int], predictions: Any) -> Exported:
    """Return a network with other predictions, whose test images are of these groups."""
    facts = replace(model.data.facts, groups=tuple(groups))
    return replace(model, data=replace(model.data, facts=facts), trained=[trained(predictions)])


def test_intervals_resample_groups_of_test_images(of_forces: Exported) -> None:
    """Of one image each they are those without groups, to the last bit; of equal frames as wide as those of presses."""
    (one,) = of_forces.trained
    predictions, count = one.weighed.predictions, len(of_forces.data.test)
    alone = with_groups(of_forces, range(count), predictions)
    assert alone.metrics == of_forces.metrics
    assert card(alone) == card(of_forces)
    frames = np.repeat(of_forces.data.test, 3)
    facts = replace(of_forces.data.facts, counts=(*of_forces.data.facts.counts[:2], 3 * count))
    several = replace(of_forces, data=replace(of_forces.data, facts=facts, test=frames))
    together = with_groups(several, np.repeat(range(count), 3).tolist(), np.repeat(predictions, 3, axis=0))
    for name, interval in of_forces.metrics.items():
        assert together.metrics[name] == pytest.approx(interval, rel=1e-6)
    text = card(together)
    assert f"{3 * count} for the test (of {count} groups)" in text
    assert f"resampled groups of test images that were recorded together ({count} groups" in text
    assert ("too few" in text) is (count < 6)


NOT_OF_RECORD = "not those of the record"


@pytest.mark.parametrize(
    ("trainings", "said", "unsaid"),
    [
        ([(True, ())], "bit for bit", "differ"),
        ([(True, ["weights_sha256"])], NOT_OF_RECORD, "bit for bit"),
        ([(False, ())], "not recorded before; trained twice, with equal bits", NOT_OF_RECORD),
        ([(False, ["weights_sha256"])], "not recorded before; **two trainings differ**: weights", NOT_OF_RECORD),
        ([(False, None)], "nothing to compare", "differ"),
        ([(True, ()), (False, ())], "1 of 2: not recorded before", NOT_OF_RECORD),
    ],
)
def test_agreement_tells_records_from_other_trainings(
    trainings: Any, said: str, unsaid: str, of_classes: Exported
) -> None:
    """What an export made itself is no record; of several trainings it is said how many each holds for."""
    predictions = of_classes.trained[0].weighed.predictions
    made = [trained(predictions, was_recorded=recorded, differing=differing) for recorded, differing in trainings]
    model = replace(of_classes, trained=made)
    assert said in agreement(model)
    assert unsaid not in agreement(model)
    for (recorded, differing), told in zip(trainings, json.loads(json.dumps(run_of(model)))["trainings"], strict=True):
        expected = None if differing is None else list(differing)
        assert told["differs_from_record"] == (expected if recorded else None)
        assert told["differs_from_other_training"] == (None if recorded else expected)


@pytest.mark.parametrize(("bits", "white"), [(8, None), (8, 200), (16, None), (16, 4095)])
def test_program_makes_the_input_as_the_data_did(
    bits: int, white: int | None, of_classes: Exported, place: Path
) -> None:
    """Of a photograph that lies on its side, of 8 bits or more, with and without a white point."""
    pixels = (
        np.random.default_rng(0)
        .integers(0, white or 2**bits - 1, (90, 50))
        .astype(np.uint8 if bits == 8 else np.uint16)
    )
    image = Image.fromarray(pixels)
    notes = Image.Exif()
    notes[0x0112] = 6
    image.save(place / "image.png", exif=notes)
    config = of_classes.plan.config
    config = replace(config, data=replace(config.data, white_point=white))
    model = replace(
        of_classes,
        plan=replace(of_classes.plan, config=config),
        catalogue=replace(of_classes.catalogue, depths=(bits,), recorded_size=(50, 90)),
    )
    told: Any = config_of(model)["input"]
    assert (told["white_point"], told["bits"], told["recorded_size"]) == (white, [bits], [50, 90])
    (place / "config.json").write_text(json.dumps(config_of(model)))
    program = re.findall(r"```python\n(.*?)```", card(model), re.DOTALL)[0].partition("[output]")[0]
    names: dict[str, Any] = {}
    exec(compile(program, "README.md", "exec"), names)
    assert names["pixels"].dtype == np.float32
    assert (names["pixels"][0] == decode(place / "image.png", told["size"], white)).all()


def test_program_prints_each_unit_once(of_forces: Exported, capsys: pytest.CaptureFixture[str]) -> None:
    """A column states its unit by its ending, which is not printed beside it; one without a unit keeps its name."""
    program = re.findall(r"```python\n(.*?)```", card(of_forces), re.DOTALL)[0]
    loop = program[program.index("for name, unit, value") :]
    outputs = {"names": ["depth_mm", "Fx", "roll_"], "units": ["mm", "N", ""]}
    exec(compile(loop, "README.md", "exec"), {"config": {"outputs": outputs}, "output": [1.25, -0.5, 3.0]})
    assert capsys.readouterr().out == "depth 1.25 mm\nFx -0.5 N\nroll_ 3\n"
