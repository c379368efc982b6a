"""Promise: what is found without asking a network is what an honest network answers, in the same order."""

from typing import Any

import pytest
import torch
from torch import nn
from torch.nn.utils import parametrizations

from tacevo.sandbox.module_parts import modules, parameters, state, switch


def _tied() -> nn.Module:
    """Make a network with a layer that stands in two places, tied weights, and a weight that is left out."""
    layer = nn.Linear(3, 3)
    other = nn.Linear(3, 3, bias=False)
    other.weight = layer.weight
    return nn.ModuleDict({"b": nn.ModuleList([layer, other]), "a": nn.Sequential(layer, nn.ReLU())})


def _transient() -> nn.Module:
    """Make a network with buffers of both kinds, and children and parameters that are None."""
    network = nn.Sequential(nn.BatchNorm2d(3, affine=False), nn.BatchNorm1d(3))
    network.register_buffer("kept", torch.zeros(2))
    network.register_buffer("lost", torch.zeros(2), persistent=False)
    network.register_module("nothing", None)
    network.register_parameter("none", None)
    return network


NETWORKS = {
    "tied": _tied(),
    "transient": _transient(),
    "transformer": nn.Transformer(8, 2, 1, 1, 8, batch_first=True),
    "lstm": nn.LSTM(3, 4, num_layers=2, bidirectional=True),
    "attention": nn.MultiheadAttention(4, 2, kdim=3, vdim=3),
    "parametrized": nn.Sequential(
        parametrizations.spectral_norm(nn.Linear(3, 3)), parametrizations.weight_norm(nn.Linear(3, 3))
    ),
    "old norms": nn.Sequential(nn.utils.spectral_norm(nn.Linear(3, 3))),
    "lists": nn.ModuleList(
        [nn.ParameterList([torch.zeros(2)]), nn.ParameterDict({"b": torch.ones(1), "a": torch.ones(2)})]
    ),
}


@pytest.mark.parametrize("network", NETWORKS.values(), ids=NETWORKS.keys())
def test_parts_are_those_of_torch(network: nn.Module) -> None:
    """The same objects in the same order, each once; names and tensors of the state, too."""
    assert [*map(id, modules(network))] == [*map(id, network.modules())]
    assert [*map(id, parameters(network))] == [*map(id, network.parameters())]
    expected = network.state_dict()
    assert [*state(network)] == [*expected]
    assert all(torch.equal(value, expected[name]) for name, value in state(network).items())


def test_every_module_is_switched() -> None:
    """Training and evaluation reach all modules, shared ones too."""
    network = _tied()
    for training in (False, True):
        switch(network, training=training)
        assert {module.training for module in network.modules()} == {training}


class _Lies(dict[str, nn.Parameter | None]):
    """Answers what it likes."""

    def items(self) -> Any:
        return []


class _Liar(nn.Linear):
    """A layer that shows another dictionary than it has."""

    @property
    def __dict__(self) -> dict[str, object]:  # type: ignore[override]
        return {"_parameters": {}, "_modules": {}}


def test_network_is_not_asked() -> None:
    """Its dictionary is read by torch's own descriptor, and the entries by the built-in method."""
    layer, other = nn.Linear(2, 2), nn.Linear(2, 2)
    layer.__class__ = _Liar
    other._parameters = _Lies(other._parameters)
    assert [len(parameters(layer)), len(parameters(other))] == [2, 2]


def test_parameter_of_another_class_is_refused() -> None:
    """Its class could define what size it has."""
    layer = nn.Linear(2, 2)
    layer._parameters["weight"] = torch.zeros(2, 2)  # type: ignore[assignment]
    with pytest.raises(TypeError, match=r"expected weight to be an nn\.Parameter; got Tensor"):
        parameters(layer)


def test_child_that_is_not_a_module_is_refused() -> None:
    """Only modules are walked."""
    network = nn.Sequential(nn.ReLU())
    network._modules["0"] = 3  # type: ignore[assignment]
    with pytest.raises(TypeError, match="Module"):
        list(modules(network))
