"""Networks of the grammar for Hypothesis, and what turns source text into a module."""

import math

import torch
from hypothesis import strategies as st
from torch import nn
from torch.nn import functional

from tacevo.llm.grammar.network import (
    Activation,
    Attention,
    Block,
    Down,
    Head,
    Hidden,
    Network,
    Norm,
    Output,
    Pooling,
    Signature,
)

SIGNATURE = Signature(
    class_name="ImageRegressionCNN",
    in_channels=3,
    output_argument="num_outputs",
    outputs=3,
    head_name="regressor",
    docstring="Maps a tactile image to the contact force along three axes.",
)

_RATES = st.sampled_from([0.0, 0.1, 0.25, 0.5, 0.05])

_SIGNATURES = st.sampled_from(
    [
        SIGNATURE,
        Signature(
            class_name="SingleLabelClassCNN",
            in_channels=1,
            output_argument="num_classes",
            outputs=7,
            head_name="classifier",
            docstring="",
        ),
    ]
)

_BLOCKS = st.builds(
    Block,
    channels=st.integers(8, 40),
    kernel=st.sampled_from([1, 3, 5, 7]),
    separable=st.booleans(),
    norm=st.sampled_from(Norm),
    activation=st.sampled_from(Activation),
    attention=st.sampled_from(Attention),
    dropout=_RATES,
    down=st.sampled_from(Down),
)

_HEADS = st.builds(
    Head,
    hidden=st.lists(
        st.builds(
            Hidden,
            width=st.integers(16, 64),
            layer_norm=st.booleans(),
            activation=st.sampled_from(Activation),
            dropout=_RATES,
        ),
        max_size=4,
    ).map(tuple),
    input_dropout=_RATES,
    output=st.sampled_from(Output),
    own_module=st.booleans(),
)


@st.composite
def networks(draw: st.DrawFn) -> Network:
    """Draw a small network; it may have more halvings than the bounds allow."""
    blocks = tuple(draw(st.lists(_BLOCKS, min_size=2, max_size=6)))
    pairs = [(source, target) for target in range(1, len(blocks) + 1) for source in range(target)]
    return Network(
        signature=draw(_SIGNATURES),
        blocks=blocks,
        skips=tuple(sorted(draw(st.sets(st.sampled_from(pairs), max_size=4)))),
        attention=draw(st.sampled_from(Attention)),
        pooling=draw(st.sampled_from(Pooling)),
        grid=draw(st.integers(1, 8)),
        head=draw(_HEADS),
        block_module=draw(st.booleans()),
    )


def build(source: str, class_name: str) -> nn.Module:
    """Run our own source text and make an instance of its class, with the names that the gate offers."""
    names: dict[str, object] = {"torch": torch, "nn": nn, "F": functional, "math": math}
    exec(source, names)
    made = names[class_name]
    assert isinstance(made, type)
    module = made()
    assert isinstance(module, nn.Module)
    return module


def train_a_step(module: nn.Module, in_channels: int, image_size: int, batch: int = 2) -> torch.Tensor:
    """Do one forward and one backward pass; return the outputs, shape (batch, outputs)."""
    generator = torch.Generator().manual_seed(0)
    outputs = module(torch.randn(batch, in_channels, image_size, image_size, generator=generator))
    assert isinstance(outputs, torch.Tensor)
    outputs.square().sum().backward()  # type: ignore[no-untyped-call]
    assert all(parameter.grad is not None for parameter in module.parameters())
    return outputs.detach()
