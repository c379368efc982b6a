"""What the tests of motifs share: networks of their own, which are therefore traced in this very process."""

import functools

import torch
from checkout import LIBRARY
from torch import nn
from torch.nn import functional as F  # noqa: N812 - the customary name, as candidates write it

from analysis.motifs.structure import Anatomy, read_anatomy
from tacevo.gate.trace import trace
from tacevo.profile import Graph, Profile

CLASSES = {"force": "ImageRegressionCNN", "grating": "SingleLabelClassCNN", "hardness": "ImageRegressionCNN"}

#: Pixels of the images that networks are traced with; more positions than any layer here has channels.
SIZE = 64


def profile_of(model: nn.Module) -> Profile:
    """Trace a network as the probe does."""
    traced = trace(model, torch.ones(1, 3, SIZE, SIZE))
    empty = Graph(nodes=(), edges=(), channels=(), kernels=(), hidden=())
    return Profile(parameters=1, flops=0, modules=1, graph=empty, steps=traced.steps, output=traced.ends)


def anatomy_of(model: nn.Module) -> Anatomy:
    """Trace a network and read how it is built."""
    return read_anatomy(profile_of(model))


def built(source: str, class_name: str) -> nn.Module:
    """Build the network that a text describes."""
    names = {"torch": torch, "nn": nn, "F": F}
    exec(source, names)
    network: nn.Module = names[class_name]()  # type: ignore[operator]
    return network


@functools.cache
def baseline(task: str) -> Anatomy:
    """Read how the baseline of a task is built."""
    source = (LIBRARY / task / "baseline.py").read_text(encoding="utf-8")
    return anatomy_of(built(source, CLASSES[task]))
