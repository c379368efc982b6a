"""The grammar reads what it writes, reads the baselines, and says what it cannot read."""

import ast
import contextlib
import re

import pytest
from checkout import LIBRARY
from grammar_strategies import SIGNATURE, networks
from hypothesis import given
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from tacevo.llm.grammar.network import Activation, Attention, Block, Down, Head, Hidden, Network, Norm, Pooling
from tacevo.llm.grammar.parsing import UnreadableError, parse
from tacevo.llm.grammar.rendering import render

BASELINE = (LIBRARY / "force" / "baseline.py").read_text()

RICH = Network(
    signature=SIGNATURE,
    blocks=(
        Block(channels=16, kernel=7, norm=Norm.batch, down=Down.stride),
        Block(channels=32, separable=True, activation=Activation.gelu, attention=Attention.channel, down=Down.max),
        Block(channels=32, norm=Norm.group, dropout=0.1),
    ),
    skips=((0, 3), (2, 3)),
    attention=Attention.spatial,
    pooling=Pooling.both,
    grid=2,
    head=Head(hidden=(Hidden(width=64, layer_norm=True, dropout=0.3),), own_module=True),
)


@given(networks())
def test_reading_undoes_writing(network: Network) -> None:
    """Every network of the grammar survives being written and read."""
    assert parse(render(network)) == network


def test_baseline_is_read_as_the_paper_describes_it() -> None:
    """Three 3x3 blocks of 32, 64 and 128 channels, a 4x4 grid and one hidden layer of 512 with dropout."""
    expected = Network(
        signature=SIGNATURE,
        blocks=tuple(Block(channels=channels, down=Down.max) for channels in (32, 64, 128)),
        head=Head(hidden=(Hidden(width=512, dropout=0.5),)),
    )
    assert parse(BASELINE) == expected


def test_comments_and_docstrings_do_not_change_what_is_read() -> None:
    """Nothing is passed from parent to child in comments, and none is needed."""
    commented = BASELINE.replace(
        "        x = self.conv2(x)\n", "        # the second stage\n        x = self.conv2(x)\n"
    )
    assert parse(commented) == parse(BASELINE)


FOREIGN = [
    ("nn.MaxPool2d(2)", "nn.MaxPool2d(3)", r"MaxPool2d\(3\)"),
    ("x = self.conv2(x)", "x = self.conv2(x) * 2", r"self.conv2\(x\) \* 2"),
    ("nn.Conv2d(32, 64, kernel_size=3, padding=1)", "nn.Conv2d(32, 64, kernel_size=3)", "kernel_size=3"),
    ("nn.Conv2d(32, 64, kernel_size=3, padding=1)", "nn.Conv2d(32, 64, 3, padding=1)", "kernel_size"),
    ("nn.Linear(128 * 4 * 4, 512)", "nn.Linear(128 * 4, 512)", r"nn.Linear\(128 \* 4, 512\)"),
    ("in_channels=3, num_outputs=3", "in_channels=3", "constructor"),
    ("self.conv1 =", "self.stem =", "at least one block"),
    ("nn.ReLU()", "nn.Hardswish()", "activation"),
    ("self.adaptive_pool =", "self.pool =", "self.adaptive_pool"),
    ("return self.regressor(x)", "return self.regressor(x).relu()", "a last line"),
    ("(32, 64, ", "(32, width, ", "a convolution"),
    ("(4, 4)", "(4, 5)", r"AdaptiveAvgPool2d\(\(4, 5\)\)"),
    ("class ImageRegressionCNN(nn.Module)", "class Other:\n    pass\nclass ImageRegressionCNN(nn.Module)", "Other"),
    ("def forward", "def backward", "def backward"),
    ("class ", "classy ", "not valid Python"),
    ("nn.Dropout(0.5)", "nn.Dropout(0.5.5)", "not valid Python"),
    ("nn.Dropout(0.5)", "nn.Dropout(rate)", r"nn.Dropout\(rate\)"),
    ("self.regressor = nn.Sequential", "self.regressor = make_head", "make_head"),
    ("self.regressor =", "self.regressor = nn.Sequential(nn.Flatten())\n        self.other =", "no linear layer"),
    ("self.regressor =", "self.regressor = Head()\n        self.other =", "the layers of class Head"),
    ("x = self.conv1(x)", "import os\n        x = self.conv1(x)", "import os"),
    ("x = self.conv1(x)", "x = " + " + ".join(["x"] * 2000), "nested too deeply"),
]


@pytest.mark.parametrize(("ours", "theirs", "named"), FOREIGN)
def test_foreign_networks_are_refused_by_naming_the_place(ours: str, theirs: str, named: str) -> None:
    """What the grammar would not write is never read as something else."""
    assert ours in BASELINE
    with pytest.raises(UnreadableError, match=named):
        parse(BASELINE.replace(ours, theirs, 1))


def plain(source: str) -> str:
    """Write a source again without the import and the docstrings of the baseline, and without comments."""
    text = ast.unparse(ast.parse(source))
    return re.sub(r'^(from torch import nn| *""".*""")\n+|\n', "", text, flags=re.MULTILINE)


@given(st.sampled_from([BASELINE, render(RICH)]), st.data())
def test_damaged_sources_are_read_rightly_or_refused(source: str, data: st.DataObject) -> None:
    """A line lost, doubled or moved, or a word exchanged: never another exception, never a wrong reading."""
    lines = source.splitlines()
    start, other = (data.draw(st.integers(0, len(lines) - 1)) for _ in range(2))
    words = [data.draw(st.sampled_from(re.findall(r"\w+", source))) for _ in range(2)]
    damaged = data.draw(
        st.sampled_from(
            [
                [*lines[:start], *lines[start + 1 :]],
                [*lines[:start], lines[other], *lines[start:]],
                [re.sub(rf"\b{words[0]}\b", words[1], line) if at == start else line for at, line in enumerate(lines)],
            ]
        )
    )
    with contextlib.suppress(UnreadableError):
        network = parse("\n".join(damaged))
        assert plain("\n".join(damaged)) == plain(render(network))


def test_helper_with_a_changed_body_is_refused() -> None:
    """The name of a helper class is not taken for its meaning."""
    with pytest.raises(UnreadableError, match="tanh"):
        parse(render(RICH).replace("x * torch.sigmoid(self.conv(summary))", "x * torch.tanh(self.conv(summary))"))


def test_source_reads_as_a_person_would_write_it(recorded_text: SnapshotAssertion) -> None:
    """The recorded text of a network that uses most parts of the grammar."""
    assert render(RICH) == recorded_text
