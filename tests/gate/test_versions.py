"""The last block with the class is the network: not the parent that a model quotes, and not an excerpt."""

import json
from collections.abc import Callable
from textwrap import indent

import pytest
from gate_cases import VALID, completion, contract, fenced, refusal_of, source_of

from tacevo.gate.extraction import extract
from tacevo.records import Reason, Rejection

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

HEADER = "class ImageRegressionCNN(nn.Module):\n"


def quoted(own: str, mark: str) -> str:
    """Put a mark before each line."""
    return indent(own, mark, lambda _: True)


#: Forms of a later version that cannot be used; alone they are no answer.
UNUSABLE: dict[str, Callable[[str], str]] = {
    "broken text": lambda own: fenced(own.replace("super().__init__()", "super().__init__("), "text"),
    "broken plaintext": lambda own: fenced(own.replace("(self, x):", "(self, x)"), "plaintext"),
    "broken in a fence of a file": lambda own: fenced(own.replace("(self, x):", "(self, x)"), "net.txt"),
    "indentation lost": lambda own: fenced("\n".join(map(str.strip, own.split("\n")))),
    "indentation lost without a fence": lambda own: "\n".join(map(str.strip, own.split("\n"))),
    "upper case": lambda own: fenced(own.replace("class ", "Class ")),
    "renamed": lambda own: fenced(own.replace("CNN(nn", "CNNv2(nn")),
    "renamed in front": lambda own: fenced(own.replace("class ", "class New")),
    "subclass": lambda own: fenced(own.replace("CNN(nn.Module)", "CNN2(ImageRegressionCNN)")),
    "function": lambda own: fenced("def ImageRegressionCNN(num_outputs=3):\n    return nn.Linear(3, num_outputs)\n"),
    "diff": lambda own: fenced(quoted(own, "+"), "diff"),
    "diff without a fence": lambda own: quoted(own, "+"),
    "bars": lambda own: quoted(own, "| "),
    "numbers": lambda own: "\n".join(f"{at:3}  {line}" for at, line in enumerate(own.split("\n"), 1)),
    "numbers and bars": lambda own: fenced("\n".join(f"{at:3}| {line}" for at, line in enumerate(own.split("\n"), 1))),
    "behind words": lambda own: f"It's now: `{own.rstrip()}`",
    "constructor left out": lambda own: fenced(
        f"{HEADER}    ...\n    def forward(self, x):\n        return self.head(x)\n"
    ),
    "forward left out": lambda own: fenced(own.split("        return")[0] + "        ...\n"),
    "new loop": lambda own: fenced(f"{HEADER}    ...\n    def forward(self, x):\n        for _ in range(3): pass\n"),
}

#: Forms of a later version that are read.
READ: dict[str, Callable[[str], str]] = {
    "alias": lambda own: fenced(own.replace("ImageRegressionCNN", "Net") + "\nImageRegressionCNN = Net\n"),
    "quote": lambda own: quoted(own, "> "),
    "quoted fence": lambda own: quoted(fenced(own), "> "),
    "prompts": lambda own: quoted(own, "... ").replace("...", ">>>", 1),
    "json": lambda own: fenced(json.dumps({"code": own}), "json"),
    "json without a fence": lambda own: json.dumps({"reason": "smaller", "code": own}, indent=2),
}

EXCERPTS = [
    "    ...\n\n    def forward(self, x):\n        ...\n",
    "    def __init__(self):\n        super().__init__()\n\n    def forward(self, x):\n        ...  # same\n",
    "    def __init__(self):\n        ...\n\n    def forward(self, x):\n" + NEW.split("\n")[-2] + "\n",
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


@pytest.mark.parametrize("form", UNUSABLE.values(), ids=UNUSABLE)
def test_version_in_another_form_is_not_replaced_by_the_parent(form: Callable[[str], str]) -> None:
    """The model's own network is lost then, but nothing is taken for it."""
    for given in (fenced(PARENT), f"\n{PARENT}", f"```text\n{PARENT}```"):
        reason = refusal_of(f"You gave:\n{given}\nIt's now:\n\n{form(NEW)}\n\nIt's small.").reason
        assert reason in (Reason.no_class, Reason.syntax)


@pytest.mark.parametrize("form", READ.values(), ids=READ)
def test_version_in_a_form_that_is_read_counts(form: Callable[[str], str]) -> None:
    """It is the later one, and its fault is its own."""
    for given in (fenced(PARENT), f"\n{PARENT}", f"```text\n{PARENT}```"):
        source = source_of(f"You gave:\n{given}\nIt's now:\n\n{form(NEW)}\n\nIt's small.")
        assert "".join(line for line in source.splitlines(keepends=True) if not line.startswith("# tacevo:")) == NEW
        reason = refusal_of(f"You gave:\n{given}\nIt's now:\n\n{form(BROKEN)}\n\nIt's small.").reason
        assert reason in (Reason.no_class, Reason.syntax)


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
    "comment", ["...", "... existing layers ...", "\u2026", "(...)", "...\uff08\u5176\u4f59\u5c42\u4e0d\u53d8\uff09"]
)
def test_comment_in_the_place_of_code_leaves_no_whole_class(comment: str) -> None:
    """Alone it is no answer, and beside another class it is an excerpt or a version that cannot be used."""
    head = "class ImageRegressionCNN(nn.Module):\n    def __init__(self, in_channels=3, num_outputs=3):\n"
    own = f"{head}        super().__init__()\n        # {comment}\n        self.scale = nn.Parameter(torch.ones(3))\n"
    own += f"\n    def forward(self, x):\n        # {comment}\n        return x.mean((2, 3)) * self.scale\n"
    assert refusal_of(fenced(own)).reason is Reason.no_class
    assert refusal_of(f"{fenced(NEW)}\nScaled:\n{fenced(own)}").reason is Reason.no_class
    assert source_of(f"{fenced(own)}\nAll of it:\n{fenced(NEW)}") == NEW


@pytest.mark.parametrize(
    "comment",
    [
        "layers as above",
        "same as before",
        "rest unchanged",
        "keep the rest",
        "and so on...",
        "\u5176\u4f59\u4ee3\u7801\u4e0d\u53d8",
    ],
)
def test_comment_about_code_counts_where_the_code_is_missing(comment: str) -> None:
    """The same words above code that is there leave out nothing."""
    lines = NEW.splitlines(keepends=True)
    at = next(at for at, line in enumerate(lines) if "self.conv =" in line)
    said = f"        # {comment}\n"
    whole = "".join([*lines[:at], said, *lines[at:]])
    assert source_of(f"{fenced(PARENT)}\n{fenced(whole)}") == whole
    part = "".join([*lines[:at], said, *lines[at + 1 :]])
    assert refusal_of(fenced(part)).reason is Reason.no_class
    assert source_of(f"{fenced(NEW)}\nIts parts:\n{fenced(part)}") == NEW


@pytest.mark.parametrize(
    "words",
    [
        "So\nclass ImageRegressionCNN is small.",
        "So\nclass ImageRegressionCNN: it is small.",
        "```\nclass ImageRegressionCNN -> conv -> head\n```",
        fenced(quoted(NEW, "> "), "text"),  # the same once more
        fenced(quoted(NEW, "+"), "diff"),
        fenced(
            "@@ -1 +1 @@ class ImageRegressionCNN(nn.Module):\n     def __init__(self):\n-        a\n+        b\n",
            "diff",
        ),
        fenced("class Net:\n    def test(self):\n        ImageRegressionCNN()\n"),
        "```diff\n class ImageRegressionCNN(nn.Module):\n     def __init__(self):\n-        a\n+        b\n```",
    ],
)
def test_what_adds_nothing_is_no_version(words: str) -> None:
    """A statement has something below it, and a diff is not Python; nor does a repetition add anything."""
    assert source_of(f"{fenced(NEW)}\n{words}") == NEW


@pytest.mark.parametrize(
    "behind",
    [
        fenced("def forward(self, x):\n    return self.head(x.mean((2, 3)))\n"),
        fenced("self.conv = nn.Conv2d(in_channels, 8, 3)\n"),
        fenced("class Net(nn.Module):\n    pass\n"),
        fenced("+class Net(nn.Module):\n", "diff"),
    ],
)
def test_given_network_before_other_code_is_no_answer(behind: str) -> None:
    """Of a network that the model was given, the rest of the answer says whether it meant to return it."""
    text = f"{fenced(VALID)}\n{behind}"
    asked = f"Change it:\n{fenced(VALID)}"
    assert source_of(text) == VALID
    verdict = extract(completion(text), contract(), asked)
    assert isinstance(verdict, Rejection)
    assert verdict.reason is Reason.no_class
    alone = f"{fenced(VALID)}\nUse it so:\n{fenced('net = ImageRegressionCNN()' + chr(10))}"
    assert extract(completion(alone), contract(), asked) == VALID
    helped = f"{fenced(VALID.replace('F.relu', 'act'))}\n{fenced('def act(x):' + chr(10) + '    return x' + chr(10))}"
    assert isinstance(extract(completion(helped), contract(), asked), str)
