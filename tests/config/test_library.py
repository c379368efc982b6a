"""The three task libraries are complete, consistent and usable as they stand."""

import re
from string import Template

import pytest
import yaml
from checkout import LIBRARY
from grammar_strategies import build, train_a_step
from torch import nn

TASKS = ("force", "grating", "hardness")
FILLED = {
    "class_name": "ImageRegressionCNN",
    "in_channels": "3",
    "image_size": "64",
    "outputs": "3",
    "output_argument": "num_outputs",
    "names": "Fx, Fy, Fz",
}


def _read(task: str, name: str) -> str:
    return (LIBRARY / task / name).read_text()


@pytest.mark.parametrize(("task", "number"), [("force", 20), ("grating", 17), ("hardness", 20)])
def test_library_holds_every_transformation_once(task: str, number: int) -> None:
    """As many as the paper lists; ids and wordings are distinct, and a crossover is there."""
    library = yaml.safe_load(_read(task, "instructions.yaml"))
    assert set(library) == {"crossover", "mutations"}
    mutations = library["mutations"]
    assert len({mutation["id"] for mutation in mutations}) == number
    assert len({mutation["text"] for mutation in mutations}) == number
    assert all(re.fullmatch(r"[a-z0-9_]+", mutation["id"]) for mutation in mutations)
    assert all(text.endswith(".") and "\n" not in text for text in (m["text"] for m in mutations))


@pytest.mark.parametrize("task", TASKS)
def test_system_prompt_is_filled_without_a_rest(task: str) -> None:
    """Every placeholder is known, and nothing else looks like one."""
    text = Template(_read(task, "system.md")).substitute(FILLED)
    assert "$" not in text
    assert "class" in text
    assert "`def __init__(self, in_channels=3, num_outputs=3)`" in text
    assert "`(N, 3, 64, 64)`" in text


@pytest.mark.parametrize(
    ("task", "class_name", "outputs", "parameters"),
    [
        ("force", "ImageRegressionCNN", 3, 1_143_875),
        ("grating", "SingleLabelClassCNN", 7, 1_145_927),
        ("hardness", "ImageRegressionCNN", 1, 1_142_849),
    ],
)
@pytest.mark.parametrize("image_size", [32, 64])
def test_baseline_trains(task: str, class_name: str, outputs: int, parameters: int, image_size: int) -> None:
    """It has the paper's parts, as many parameters as the layers add up to, and its outputs have their shape."""
    module = build(_read(task, "baseline.py"), class_name)
    assert {"conv1", "conv2", "conv3", "adaptive_pool"} <= {name for name, _ in module.named_children()}
    assert sum(parameter.numel() for parameter in module.parameters()) == parameters
    assert train_a_step(module, 3, image_size).shape == (2, outputs)


@pytest.mark.parametrize("task", TASKS)
def test_baseline_takes_another_number_of_channels(task: str) -> None:
    """The constructor's arguments have defaults and are used."""
    names: dict[str, object] = {}
    exec(_read(task, "baseline.py"), names)
    made = next(value for value in names.values() if isinstance(value, type) and issubclass(value, nn.Module))
    assert train_a_step(made(in_channels=1), 1, image_size=32).shape[0] == 2
