"""Blocks that bind what the class lacks come with it; words and examples do not."""

import pytest
from gate_cases import VALID, fenced, source_of

USING = VALID.replace("4, 3)", "WIDTH, 3)")


@pytest.mark.parametrize(
    "block",
    [
        "WIDTH = 4",
        "WIDTH: int = 4",
        "WIDTH, DEPTH = 4, 2",
        "[(WIDTH, *REST), DEPTH] = [(4, 1), 2]",
        "DEPTH = WIDTH = 4",
        "WIDTH = 2\nWIDTH *= 2",
        "if (WIDTH := 4):\n    pass",
        "for WIDTH in [4]:\n    pass",
        "try:\n    WIDTH = 4\nexcept Exception:\n    WIDTH = 2",
        "with torch.no_grad() as WIDTH:\n    pass",
        "def WIDTH():\n    return 4",
        "class WIDTH:\n    pass",
        "import sizes as WIDTH",
        "from sizes import WIDTH",
        "from sizes import width as WIDTH",
        "import torch\nimport torch.nn as nn\n\nWIDTH = 4",
    ],
)
def test_name_in_any_form_of_binding_is_found(block: str) -> None:
    """Before the class or after it."""
    for first, second in ((block, USING), (USING, block)):
        text = f"First:\n{fenced(first + chr(10))}\nThen:\n{fenced(second + chr(10))}"
        assert source_of(text) == f"{block}\n\n{USING}"


@pytest.mark.parametrize(
    ("block", "old", "new"),
    [
        ("import torch\nfrom functools import partial", "nn.Conv2d(in", "partial(nn.Conv2d)(in"),
        ("import torch.nn.functional as Fn", "F.relu", "Fn.relu"),
        ("from typing import Optional\nimport torch", "forward(self, x)", "forward(self, x: Optional[int] = None)"),
        ("width = 4", "num_outputs=3)", "num_outputs=3, width=width)"),
        ("width = 4", "(nn.Module)", "(nn.Module, base(width))"),
        ("import os.path", "F.relu", "os.path.join"),
        ("act = nn.SiLU()", "return self", "return [act(act) for x in x], self"),
    ],
)
def test_name_is_looked_up_where_python_would(block: str, old: str, new: str) -> None:
    """An argument of the same name does not hide the default that it is given."""
    using = VALID.replace(old, new)
    assert source_of(f"{fenced(block + chr(10))}\n{fenced(using)}") == f"{block}\n\n{using}"


@pytest.mark.parametrize(
    "block",
    [
        "import torch\nimport torch.nn as nn\nimport torch.nn.functional as F",  # provided
        "x = torch.randn(1, 3, 32, 32)",  # a variable of the class
        "self = 1\nin_channels = 3",
        "import torch\nmodel = ImageRegressionCNN()\nWIDTH = model.conv",  # an example
        "if __name__ == '__main__':\n    WIDTH = ImageRegressionCNN()",
        "DEPTH = 4",
    ],
)
def test_block_that_is_not_lacked_is_left_out(block: str) -> None:
    """An example of use would fail before the class, and what is provided need not be imported."""
    class_ = USING if "ImageRegressionCNN" in block else VALID
    assert source_of(f"{fenced(class_)}\nLike so:\n{fenced(block + chr(10))}") == class_


@pytest.mark.parametrize(
    "helper", ["class Gate(nn.Module):\n    pass", "from __future__ import annotations\n\nGate = 1"]
)
def test_future_imports_come_first(helper: str) -> None:
    """Python refuses them anywhere else."""
    future = "from __future__ import annotations\n"
    using = VALID.replace("F.relu", "Gate")
    source = source_of(f"{fenced(helper + chr(10))}\n{fenced(future + using)}")
    assert source.startswith(future)
    assert source.count("__future__") == 1
    compile(source, "<source>", "exec")


def test_future_import_of_another_block_counts() -> None:
    """It binds no name that the class uses, but without it an annotation may fail."""
    future = "from __future__ import annotations\nimport torch"
    assert source_of(f"{fenced(future + chr(10))}\n{fenced(VALID)}") == f"{future}\n\n{VALID}"


def test_earlier_version_lends_what_stands_beside_it() -> None:
    """A model that shows the whole file first repeats only the class."""
    earlier = f"import sizes\n\nWIDTH = sizes.WIDTH\n\n\n@decorated\n{VALID}"
    assert source_of(f"{fenced(earlier)}\nNow:\n{fenced(USING)}") == f"import sizes\n\nWIDTH = sizes.WIDTH\n\n{USING}"


@pytest.mark.parametrize(
    "words",
    [
        "python",
        "Sure",
        "Done",
        "Okay,",
        "Improved_model",
        "Two-stage",
        "net.py",
        "encoder/decoder",
        "Answer: below",
        "(Yes)",
    ],
)
@pytest.mark.parametrize("write", ["{}", "```python\n{}\n```"])
def test_words_that_parse_are_not_code(words: str, write: str) -> None:
    """They are names that nobody binds."""
    assert source_of(write.format(f"{words}\n{VALID}")) == VALID
    assert source_of(write.format(f"{VALID}\n{words}")) == VALID
    assert (
        source_of(write.format(f"{words}  # so\nimport sizes\n\n{words}\n{VALID}\n{words};"))
        == f"import sizes\n\n{VALID}"
    )


@pytest.mark.parametrize(
    "line", ['"""A network."""', "ImageRegressionCNN.width = 4", "print(4)", "WIDTH: int = 4", "x = y"]
)
def test_code_is_not_taken_for_words(line: str) -> None:
    """A docstring and whatever has an effect stay."""
    assert source_of(f"{line}\n{VALID}") == f"{line}\n{VALID}"
