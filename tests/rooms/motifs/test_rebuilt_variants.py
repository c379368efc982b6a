"""The paper's eight variants are rebuilt with exactly the changes that its supplement lists."""

import pytest
from checkout import LIBRARY
from motif_cases import CLASSES, anatomy_of, baseline, built

from analysis.motifs.motifs import motifs_of

#: What every force variant has; the names are those of the motifs (docs/motifs.md).
_FORCE = {"spatial attention", "strided convolution for max pooling"}
_GRATING = {"wider convolutions", "deeper head", "no dropout", "BatchNorm in the blocks", "LayerNorm in the head"}

#: The supplement's tables A and B, in the words of the motifs. A strided convolution and a further one count as blocks.
CHANGES = {
    ("force", 1): _FORCE | {"more convolutional blocks", "narrower hidden layer", "LeakyReLU"},
    ("force", 2): _FORCE | {"more convolutional blocks", "narrower hidden layer"},
    ("force", 3): _FORCE | {"more convolutional blocks", "1x1 convolution"},
    ("force", 4): _FORCE | {"more convolutional blocks"},
    ("grating", 1): _GRATING | {"GELU"},
    ("grating", 2): _GRATING,
    ("grating", 3): _GRATING | {"GELU", "residual connection"},
    ("grating", 4): _GRATING | {"residual connection"},
}

#: Says nothing here: the number of blocks has a test of its own.
BESIDE = {"2 to 4 convolutional blocks"}

#: Attributes conv1, conv2, ... of the force variants: 3 to 2 blocks twice, and a fourth one.
BLOCKS = {1: 2, 2: 2, 3: 3, 4: 4}


def _source(task: str, number: int) -> str:
    return (LIBRARY / task / "published" / f"variant{number}.py").read_text(encoding="utf-8")


@pytest.mark.parametrize(("task", "number"), CHANGES)
def test_variant_differs_from_the_baseline_by_the_listed_changes(task: str, number: int) -> None:
    """No listed change is missing, and none is added."""
    network = anatomy_of(built(_source(task, number), CLASSES[task]))
    assert motifs_of(network, baseline(task)) - BESIDE == CHANGES[task, number]


def test_network_by_hand_is_the_baseline_with_two_edits() -> None:
    """BatchNorm and GELU, and nothing else."""
    network = built((LIBRARY / "grating" / "by_hand.py").read_text(encoding="utf-8"), CLASSES["grating"])
    assert motifs_of(anatomy_of(network), baseline("grating")) - BESIDE == {"BatchNorm in the blocks", "GELU"}


@pytest.mark.parametrize("number", BLOCKS)
def test_force_variant_has_the_listed_number_of_blocks(number: int) -> None:
    """A block is an attribute `convN`, as in the baseline."""
    names = [name for name, _ in built(_source("force", number), CLASSES["force"]).named_children()]
    assert sum(name.startswith("conv") for name in names) == BLOCKS[number]
