"""The baselines of the libraries train as they stand; their texts: `test_composition.py`."""

import pytest
from checkout import LIBRARY
from grammar_strategies import build, train_a_step
from torch import nn

pytestmark = pytest.mark.room("grammar")

TASKS = ("force", "grating", "hardness", "shape")


def _baseline(task: str) -> str:
    return (LIBRARY / task / "baseline.py").read_text()


@pytest.mark.parametrize(
    ("task", "class_name", "outputs", "parameters"),
    [
        ("force", "ImageRegressionCNN", 3, 1_143_875),
        ("grating", "SingleLabelClassCNN", 7, 1_145_927),
        ("hardness", "ImageRegressionCNN", 1, 1_142_849),
        ("shape", "SingleLabelClassCNN", 9, 1_146_953),
    ],
)
@pytest.mark.parametrize("image_size", [32, 64])
def test_baseline_trains(task: str, class_name: str, outputs: int, parameters: int, image_size: int) -> None:
    """It has the paper's parts, as many parameters as the layers add up to, and its outputs have their shape."""
    module = build(_baseline(task), class_name)
    assert {"conv1", "conv2", "conv3", "adaptive_pool"} <= {name for name, _ in module.named_children()}
    assert sum(parameter.numel() for parameter in module.parameters()) == parameters
    assert train_a_step(module, 3, image_size).shape == (2, outputs)


@pytest.mark.parametrize("task", TASKS)
def test_baseline_takes_another_number_of_channels(task: str) -> None:
    """The constructor's arguments have defaults and are used."""
    names: dict[str, object] = {}
    exec(_baseline(task), names)
    made = next(value for value in names.values() if isinstance(value, type) and issubclass(value, nn.Module))
    assert train_a_step(made(in_channels=1), 1, image_size=32).shape[0] == 2


@pytest.mark.parametrize(
    ("name", "parameters", "width"),
    # As torchvision and timm count them for 1,000 classes: 11,689,512, 28,589,128 and 22,050,664.
    [("resnet18", 11_689_512, 512), ("convnext_tiny", 28_589_128, 768), ("vit_small", 22_050_664, 384)],
)
def test_networks_of_the_release_are_those_of_their_papers(name: str, parameters: int, width: int) -> None:
    """But for the last layer, which has nine classes; any size of images will do."""
    module = build((LIBRARY / "tacverse" / f"{name}.py").read_text(), "SingleLabelClassCNN")
    assert sum(parameter.numel() for parameter in module.parameters()) == parameters - (1000 - 9) * (width + 1)
    assert train_a_step(module, 3, 32).shape == (2, 9)
