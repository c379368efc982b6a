"""A copy of a network that the model was given does not count beside a version of its own, before or behind it."""

from textwrap import indent

import pytest
from gate_cases import VALID, completion, contract, fenced

from tacevo.gate.extraction import extract
from tacevo.gate.likeness import is_same_network
from tacevo.records import Reason, Rejection

NAME = "ImageRegressionCNN"
HELPER = "class Block(nn.Module):\n    def forward(self, x):\n        return F.relu(x)\n"
PARENT = (
    f'"""What the model was given."""\n\nfrom torch import nn\n\n\n{HELPER}\n\n{VALID.replace("F.relu", "Block()")}'
)
OTHER = VALID.replace("4", "6")
NEW = VALID.replace("4", "8")
BROKEN = NEW.replace("nn.Linear(8, num_outputs)", "nn.Linear(8, num_outputs")
ASKED = (
    f"First parent network:\n\n{fenced(PARENT)}\n\nSecond parent network:\n\n{fenced(OTHER)}\n\nInstruction: breed.\n"
)

#: How a network that was given may be quoted.
COPIES = {
    "whole": PARENT,
    "second parent": OTHER,
    "class alone": PARENT.rsplit("\n\n\n", maxsplit=1)[-1],
    "without docstrings": PARENT.replace('"""What the model was given."""\n\n', "").replace(
        '    """Tiny but trainable."""\n\n', ""
    ),
    "other docstrings": PARENT.replace("Tiny but trainable.", "The parent."),
    "comments": PARENT.replace("super().__init__()", "super().__init__()  # as usual"),
    "comment lines": PARENT.replace("        self.head", "        # the head\n        self.head"),
    "without imports": PARENT.replace("from torch import nn\n", ""),
    "more imports": PARENT.replace(
        "from torch import nn\n", "import torch\nimport torch.nn as nn\nimport torch.nn.functional as F\n"
    ),
    "other layout": PARENT.replace(
        "nn.Conv2d(in_channels, 4, 3)",
        "nn.Conv2d(\n            in_channels,\n            4,\n            3,\n        )",
    ),
    "other quotes and blank lines": PARENT.replace("\n\n\n", "\n").replace('"""', "'''"),
    "other order": f"{PARENT.rsplit(chr(10) * 3, maxsplit=1)[-1]}\n\n{HELPER}",
    "with its use": f"{PARENT}\n\nnet = {NAME}()\n",
}

#: How the model may show its own network and the copy.
SHOWN = {
    "behind": "It's this:\n{own}\nTo compare, what I was given:\n{copy}",
    "before": "I was given:\n{copy}\nIt's now:\n{own}",
    "on both sides": "I was given:\n{copy}\nIt's now:\n{own}\nIt was:\n{copy}",
    "twice behind": "{own}\n\nIt was:\n{copy}\nAgain:\n{copy}",
    "folded": "{own}\n\n<details>\n<summary>starting point</summary>\n\n{copy}\n\n</details>",
    "tags": "<child>\n{own}\n</child>\n<parent>\n{copy}\n</parent>",
}

WRITTEN = {
    "fenced": fenced,
    "bare": lambda code: f"\n{code}\nSo.\n",
    "text": lambda code: fenced(code, "text"),
    "quoted": lambda code: indent(fenced(code), "> ", lambda _: True),
}

#: How a model may write a change of a network without writing the network.
EDITS = {
    "diff": fenced("-        nn.ReLU(),\n+        nn.GELU(),\n", "diff"),
    "diff with its head": fenced("--- a/net.py\n+++ b/net.py\n@@ -3,7 +3,7 @@\n-    4,\n+    8,\n", "diff"),
    "diff in a bare fence": fenced("- nn.ReLU(),\n+ nn.GELU(),\n", ""),
    "diff without a fence": "- nn.ReLU(),\n+ nn.GELU(),\n",
    "search and replace": fenced("<<<<<<< SEARCH\n    4,\n=======\n    8,\n>>>>>>> REPLACE\n", ""),
    "patch": "*** Begin Patch\n*** Update File: net.py\n@@\n-4\n+8\n*** End Patch\n",
    "before and after": f"Before:\n{fenced('nn.ReLU(),' + chr(10))}\nAfter:\n{fenced('nn.GELU(),' + chr(10))}",
    "indented": "Replace\n\n    nn.ReLU()\n\nwith\n\n    nn.GELU()\n",
    "statement": fenced("x = F.gelu(x)\n"),
    "return": fenced("return 2 * self.head(x)\n"),
    "constant": fenced("width = 16\n"),
    "json": fenced('{"old": "nn.ReLU()", "new": "nn.GELU()"}\n', "json"),
    "json without a fence": '{"old": "nn.ReLU()", "new": "nn.GELU()"}\n',
    "command": fenced("sed -i 's/ReLU/GELU/' net.py\n", "bash"),
    "method set": fenced(f"{NAME}.forward = new_forward\n"),
    "part set": fenced(f"model = {NAME}()\nmodel.layers[3] = nn.Dropout(0.2)\n"),
    "part set by its name": fenced(f"model = {NAME}().eval()\nsetattr(model, 'head', other)\n"),
    "part changed": fenced(f"model = {NAME}()\nmodel.head.p = 0.2\n"),
    "part added": fenced(f"model = {NAME}()\nmodel.layers.append(other)\n"),
    "weights": fenced(f"model = {NAME}()\nfor w in model.parameters():\n    nn.init.zeros_(w)\n"),
    "table": "| 1 | `self.conv = nn.Conv2d(in_channels, 9, 3)` |\n",
    "html": "<code>self.conv = nn.Conv2d(in_channels, 9, 3)<br></code>\n",
    "lines of a string": fenced("lines = '\\n'.join(['self.conv = nn.Conv2d(3, 9, 3)'])\n"),
}

#: What may stand beside a network that is returned as it was given.
USES = {
    "words": "It has `nn.ReLU()` and is:\n\n- small\n- fast - and good\n\n1. Two layers.\n\n---\n",
    "use": fenced(f"model = {NAME}().to('cpu')\nprint(model(torch.zeros(1, 3, 8, 8)).shape)\n"),
    "use without a fence": f"Use it so:\n\nnet = {NAME}(3, 3)\nprint(net)\n",
    "use in two blocks": f"{fenced(f'net = {NAME}()' + chr(10))}\nand\n{fenced('y = net(x)' + chr(10))}",
    "training": fenced(
        f"net = {NAME}()\nadam = torch.optim.Adam(net.parameters())\nloss = F.mse_loss(net(x), y)\n"
        "adam.zero_grad()\nloss.backward()\nadam.step()\n"
    ),
    "excerpt": fenced("        self.conv = nn.Conv2d(in_channels, 4, 3)\n"),
}


def verdict(text: str, asked: str = ASKED) -> str | Rejection:
    """Extract from an answer to a question that gives networks."""
    return extract(completion(text), contract(), asked)


@pytest.mark.few(60)
@pytest.mark.parametrize("copy", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("shown", SHOWN.values(), ids=SHOWN)
@pytest.mark.parametrize("write", WRITTEN.values(), ids=WRITTEN)
def test_copy_of_a_given_network_does_not_count_beside_another_version(copy: str, shown: str, write: object) -> None:
    """The model's own network is the child, and its fault is its own."""
    assert callable(write)
    assert verdict(shown.format(own=fenced(NEW), copy=write(copy))) == NEW
    broken = verdict(shown.format(own=fenced(BROKEN), copy=write(copy)))
    assert isinstance(broken, Rejection)
    assert broken.reason is Reason.syntax


@pytest.mark.parametrize("copy", COPIES.values(), ids=COPIES)
def test_copy_alone_is_the_answer(copy: str) -> None:
    """A model may return a network as it was given."""
    assert isinstance(verdict(fenced(copy)), str)
    assert isinstance(verdict(f"I leave it as it is:\n{fenced(copy)}\nIt is small."), str)
    assert isinstance(verdict(f"{fenced(PARENT)}\n{fenced(OTHER)}"), str)


@pytest.mark.parametrize("copy", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize(
    "part",
    [
        fenced(f"class {NAME}(nn.Module):\n    ...\n\n    def forward(self, x):\n        return 2 * self.head(x)\n"),
        fenced("def forward(self, x):\n    return 2 * x\n"),
        fenced("self.conv = nn.Conv2d(in_channels, 8, 3)\n"),
        fenced(f"class {NAME}v2(nn.Module):\n    pass\n"),
        fenced(f"if True:\n{indent(NEW, '    ')}"),
        fenced(f"class Image\u200bRegressionCNN(nn.Module):{NEW.split(':', 1)[1]}"),
        indent(NEW, "+"),
        fenced("class Head(nn.Module):\n    pass\n"),
        *EDITS.values(),
    ],
)
def test_copy_beside_parts_of_another_network_is_no_answer(copy: str, part: str) -> None:
    """Before it or behind it: the model meant a change that nobody can put together."""
    for text in (f"{fenced(copy)}\nChange:\n{part}", f"Change:\n{part}\nThis is what I was given:\n{fenced(copy)}"):
        rejection = verdict(text)
        assert isinstance(rejection, Rejection)
        assert rejection.reason in (Reason.no_class, Reason.syntax)


@pytest.mark.parametrize("use", USES.values(), ids=USES)
def test_copy_beside_an_example_of_its_use_is_the_answer(use: str) -> None:
    """A model that returns a network as it was given may say so, and may show how it is used."""
    assert verdict(f"{fenced(PARENT)}\n{use}") == PARENT
    assert verdict(f"{use}\n{fenced(PARENT)}") == PARENT


def test_copy_with_another_helper_is_a_network_of_its_own() -> None:
    """The class is the same, but what it is made of is not."""
    changed = HELPER.replace("relu", "gelu")
    alone = PARENT.rsplit("\n\n\n", maxsplit=1)[-1]
    assert verdict(fenced(f"{changed}\n\n{alone}")) == f"{changed}\n\n{alone}"
    assert verdict(f"{fenced(changed)}\nThe rest stays:\n{fenced(alone)}") == f"{changed.rstrip()}\n\n{alone}"
    both = f"{fenced(changed + chr(10) + chr(10) + alone)}\nI was given:\n{fenced(PARENT)}"
    assert verdict(both) == f"{changed}\n\n{alone}"
    behind = verdict(f"{fenced(PARENT)}\nWith this in it:\n{fenced(changed)}")
    assert isinstance(behind, Rejection)


def test_version_that_was_not_given_counts_wherever_it_stands() -> None:
    """Without a question, or with another one, the last version counts."""
    text = f"{fenced(NEW)}\nIt was:\n{fenced(OTHER)}"
    assert verdict(text) == NEW
    assert verdict(text, "") == OTHER
    assert verdict(text, f"Change it:\n{fenced(VALID)}") == OTHER
    assert verdict(text, f"Change it:\n\n{OTHER}\n\nPlease.") == NEW
    assert verdict(text, OTHER) == NEW


def test_excerpt_of_a_given_network_behind_the_answer_is_no_version() -> None:
    """It shows what was changed."""
    head = f"class {NAME}(nn.Module):\n"
    for excerpt in (
        f"{head}    ...\n        self.conv = nn.Conv2d(in_channels, 6, 3)\n",
        f"{head}    def __init__(self, in_channels=3):\n        self.conv = nn.Conv2d(in_channels, 6, 3)\n",
        f"{head}    ...\n    def forward(self, x):\n        return self.head(F.relu(self.conv(x)).mean((2, 3)))\n",
    ):
        assert verdict(f"{fenced(NEW)}\nIt was:\n{fenced(excerpt)}") == NEW


@pytest.mark.parametrize(
    "copy", [name for name in COPIES if name not in ("second parent", "class alone", "with its use")]
)
def test_sources_that_differ_in_words_only_are_one_network(copy: str) -> None:
    """Comments, docstrings, layout, order, and imports of what the sandbox provides do not count."""
    assert is_same_network(PARENT, COPIES[copy])
    assert not is_same_network(
        PARENT, COPIES[copy].replace("4, 3)", "4, 5)").replace("            3,\n", "            5,\n")
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("F.relu(x)", "F.gelu(x)"),
        ("4", "5"),
        ("2, 3", "3, 2"),
        ("from torch import nn", "from torch import nn\nfrom torch.nn import ReLU as Block"),
        ("mean", "amax"),
        ("num_outputs=3", "num_outputs=3.0"),
        ("return F", "return -F"),
        ('"""Tiny but trainable."""', "scale = 2"),
    ],
)
def test_sources_that_compute_something_else_are_two_networks(old: str, new: str) -> None:
    """Be it a number's type or a name's origin."""
    assert not is_same_network(PARENT, PARENT.replace(old, new))
    assert not is_same_network(PARENT, PARENT + "\n(")
