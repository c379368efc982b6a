"""The last block with the class is the network: not the parent that a model quotes, and not an excerpt."""

from collections.abc import Callable

import pytest
from gate_cases import VALID, fenced, refusal_of, source_of

from tacevo.records import Reason

PARENT = VALID
NEW = VALID.replace("4", "8")
BROKEN = NEW.replace("nn.Linear(8, num_outputs)", "nn.Linear(8, num_outputs")

#: What may be wrong with the class that the model wrote last.
FAULTS = {
    "bracket": BROKEN,
    "colon": NEW.replace("forward(self, x):", "forward(self, x)"),
    "header": NEW.replace("(nn.Module):", "(nn.Module"),
    "no header": NEW.replace("(nn.Module):", ""),
    "header only": NEW.split("\n")[0],
    "string": NEW.replace('trainable."""', "trainable."),
    "indentation": NEW.replace("        super", "    super"),
    "tab": NEW.replace("        self.head", "\tself.head"),
    "body": NEW.split("        return")[0],
    "invisible": NEW.replace("        self.head", "\u200b        self.head"),
    "null": f"{NEW}# \0",
}

#: How the model may show the network that it was given, and then its own.
SHOWN: dict[str, Callable[[str], str]] = {
    "two fences": lambda own: f"You gave:\n{fenced(PARENT)}\nI'd change it:\n{fenced(own)}",
    "end mark": lambda own: f"{fenced(PARENT)}\n{fenced(own)}<|im_end|>",
    "end mark after both": lambda own: f"{fenced(PARENT)}<|eot_id|>\n{fenced(own)}<|eot_id|>",
    "first not closed": lambda own: f"```python\n{PARENT}\nIt's now:\n{fenced(own)}",
    "last not closed": lambda own: f"{fenced(PARENT)}\n```python\n{own}",
    "first closed on code": lambda own: f"{fenced(PARENT.rstrip())}\nIt's now:\n{fenced(own)}",
    "other mark": lambda own: f"{fenced(PARENT)}\n{fenced(own, 'pytorch')}",
    "own without fences": lambda own: f"{fenced(PARENT)}\nIt's now:\n\n{own}\nIt's done.",
    "parent without fences": lambda own: f"You gave:\n\n{PARENT}\nIt's now:\n{fenced(own)}",
    "no fences": lambda own: f"You gave:\n\n{PARENT}\nIt's now:\n\n{own}\nIt's done.",
    "tags": lambda own: f"<parent>{PARENT.rstrip()}</parent>\n<child>{own.rstrip()}</child>",
}

EXCERPTS = [
    "    ...\n\n    def forward(self, x):\n        ...\n",
    "    def __init__(self):\n        self.new = 1\n\n    def forward(self, x):\n        ...  # same\n",
    "    def __init__(self):\n        ...\n\n    def forward(self, x):\n        return self.head(x)\n",
    "    def forward(self, x):\n        pass\n",
    "    def forward(self, x):\n        raise NotImplementedError\n",
    '    def forward(self, x):\n        """Unchanged."""\n',
    "    def forward(self, x): ...\n",
    "    # the rest is unchanged\n",
    "    def __init__(self):\n        super().__init__()\n\n    def forward(self, x):\n        # unchanged\n",
]


@pytest.mark.parametrize("shown", SHOWN.values(), ids=SHOWN)
def test_parent_that_is_quoted_is_not_the_child(shown: Callable[[str], str]) -> None:
    """The class that was written last counts, letter for letter."""
    assert source_of(shown(NEW)) == NEW


@pytest.mark.parametrize("shown", SHOWN.values(), ids=SHOWN)
def test_parent_does_not_stand_in_for_a_broken_child(shown: Callable[[str], str]) -> None:
    """An archive would otherwise hold a mutation that is its parent."""
    assert refusal_of(shown(BROKEN)).reason is Reason.syntax


@pytest.mark.parametrize("own", FAULTS.values(), ids=FAULTS)
def test_no_fault_brings_the_parent_back(own: str) -> None:
    """Whatever keeps the last class from being parsed."""
    given = f"You gave:\n{fenced(PARENT)}\nIt's now:\n"
    assert refusal_of(f"{given}{fenced(own + chr(10))}").reason is Reason.syntax
    if own not in (FAULTS["header only"], FAULTS["invisible"]):  # without a fence, these may be sentences
        assert refusal_of(f"{given}\n{own}\nIt's small.").reason is Reason.syntax


@pytest.mark.parametrize("own", [BROKEN, FAULTS["string"]])
def test_broken_class_may_be_corrected(own: str) -> None:
    """A later version counts, whatever stands before it."""
    assert source_of(f"{fenced(own)}\nThat was wrong:\n{fenced(NEW)}") == NEW


@pytest.mark.parametrize("excerpt", EXCERPTS)
@pytest.mark.parametrize("write", [fenced, "\n{}\nIt's short.".format], ids=["fenced", "bare"])
def test_excerpt_does_not_replace_the_class(excerpt: str, write: Callable[[str], str]) -> None:
    """What leaves parts out is no version, before the class or after it, but a broken class between is one."""
    excerpt = f"class ImageRegressionCNN(nn.Module):\n{excerpt}"
    assert source_of(f"It's this:\n{write(NEW)}\nOnly this changed:\n{write(excerpt)}") == NEW
    assert source_of(f"Only this changes:\n{write(excerpt)}\nIt's this:\n{write(NEW)}") == NEW
    both = f"You gave:\n{write(PARENT)}\nIt's now:\n{write(BROKEN)}\nSo this changed:\n{write(excerpt)}"
    assert refusal_of(both).reason is Reason.syntax


@pytest.mark.parametrize(
    "words",
    [
        "So\nclass ImageRegressionCNN is small.",
        "So\nclass ImageRegressionCNN: it is small.",
        "```\nclass ImageRegressionCNN -> conv -> head\n```",
        "```diff\n class ImageRegressionCNN(nn.Module):\n     def __init__(self):\n-        a\n+        b\n```",
    ],
)
def test_words_about_the_class_are_no_version(words: str) -> None:
    """A statement has something below it, and a diff is not Python."""
    assert source_of(f"{fenced(NEW)}\n{words}") == NEW
