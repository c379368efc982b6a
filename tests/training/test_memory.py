"""Promise: what a training will take of a GPU follows from the probe's profile, and is counted as documented."""

from dataclasses import replace

import pytest
from training_jobs import RECIPE

from tacevo.profile import Graph, Profile, Step
from tacevo.records import Contract, Kind, Loss
from tacevo.training.memory import predicted_mib

MIB = 2**20
CONTRACT = Contract(
    class_name="Net",
    kind=Kind.regression,
    loss=Loss.mse,
    in_channels=3,
    image_size=256,
    outputs=3,
    output_argument="n",
)
GRAPH = Graph(nodes=(), edges=(), channels=(), kernels=(), hidden=())


def profile(*shapes: tuple[int, ...], parameters: int = 1) -> Profile:
    """Make the profile of a network whose steps give such results for one image."""
    steps = tuple(Step(op="relu", weighted=False, sources=(), operands=(), shape=shape) for shape in shapes)
    return Profile(parameters=parameters, flops=0, modules=0, graph=GRAPH, steps=steps)


def test_prediction_is_counted_by_hand() -> None:
    """Two networks, each with four values a parameter and two an activation, all images, and 512 MiB beside."""
    recipe = replace(RECIPE, batch_size=32)
    one = profile((1, 8, 128, 128), (1, 16, 64, 64), parameters=MIB)
    activations = 32 * (8 * 128**2 + 16 * 64**2)
    values = 2 * 4 * (4 * MIB + 2 * activations)
    assert predicted_mib(one, CONTRACT, recipe, 1024) == (values + 1024 * 3 * 256**2) / MIB + 512


@pytest.mark.parametrize("change", ["batch", "shape", "parameters", "images"])
def test_more_of_anything_takes_more(change: str) -> None:
    """Batches, activations, parameters and images."""
    small = predicted_mib(profile((1, MIB)), CONTRACT, replace(RECIPE, batch_size=8), 100)
    large = predicted_mib(
        profile((1, MIB * (2 if change == "shape" else 1)), parameters=MIB if change == "parameters" else 1),
        CONTRACT,
        replace(RECIPE, batch_size=16 if change == "batch" else 8),
        200 if change == "images" else 100,
    )
    assert small is not None
    assert large is not None
    assert large > small


def test_nothing_is_predicted_without_steps() -> None:
    """Profiles of early releases and of very long networks have none."""
    assert predicted_mib(profile(), CONTRACT, RECIPE, 100) is None
