"""What it costs to read an answer grows as its size, up to bounds that are the same on every machine."""

import ast
import sys
from collections.abc import Callable
from typing import Any

import pytest
from gate_cases import VALID, completion, contract, extracted, fenced, source_of

from tacevo.gate import blocks
from tacevo.gate.blocks import BlockParser
from tacevo.gate.joining import ParsedCode
from tacevo.gate.policy import problems
from tacevo.gate.policy.check import rejection_of
from tacevo.gate.versions import Known, later_version
from tacevo.records import Reason, Rejection
from tacevo.text import parse_python

CLASS = "class ImageRegressionCNN(nn.Module):\n"

#: Answers of about so many characters that try to be slow to read.
SLOW: dict[str, Callable[[int], str]] = {
    "spaces behind a fence": lambda size: f"```{' ' * size}`",
    "backticks": lambda size: "`" * size,
    "fences": lambda size: "```\nx\n```\n" * (size // 10) + VALID,
    "fences that open": lambda size: "```python\n" * (size // 10) + VALID,
    "fences on one line": lambda size: "``` " * (size // 4),
    "quotes": lambda size: '```\n"""\n```\n' * (size // 12) + VALID,
    "strings": lambda size: "```\n" + "'\\" * (size // 2) + VALID,
    "thoughts": lambda size: "<think>\n" * (size // 8) + VALID,
    "closed thoughts": lambda size: "<think>a</think>" * (size // 16) + VALID,
    "half a tag": lambda size: "<think " * (size // 7) + VALID,
    "tags": lambda size: "<a>" * (size // 3) + VALID,
    "tags behind code": lambda size: f"```\n{VALID.rstrip()}{'<a> ' * (size // 4)}x\n```",
    "channels": lambda size: "<|channel|>analysis" * (size // 19) + VALID,
    "indented lines": lambda size: f"It's:\n{' ' * size}{VALID}",
    "blank lines": lambda size: f"It's:\n```\n{CLASS}" + "\n  " * (size // 3) + "x",
    "comments": lambda size: f"It's:\n```\n{CLASS}  def forward(self):\n" + "    #\n" * (size // 6) + "    x y\n",
    "words": lambda size: "w\n" * (size // 2) + VALID,
    "names": lambda size: fenced("q = 1\n") + "\n" + fenced(VALID + "".join(f"a{i} = 1\n" for i in range(size // 9))),
    "names of one function": lambda size: (
        VALID + " = ".join(f"a{i}" for i in range(size // 9)) + f" = lambda: {' + '.join(['x'] * 50)}\n"
    ),
    "JSON": lambda size: '{"a": [' * (size // 7) + VALID,
    "JSON with sources": lambda size: '{"a": "class ImageRegressionCNN:\\n"}\n' * (size // 40) + VALID,
    "JSON never closed": lambda size: '{"ImageRegressionCNN' * (size // 20) + VALID,
    "braces": lambda size: "{ " * (size // 2) + VALID,
    "quoted lines": lambda size: "> import a\n" * (size // 11) + VALID,
    "quoted quotes": lambda size: f"{'>' * (size // 2)}import a\n" * 2 + VALID,
    "quoted blank lines": lambda size: "> import a\n\n" * (size // 12) + VALID,
    "prompts": lambda size: ">>> class ImageRegressionCNN\n... x\n" * (size // 36) + VALID,
    "here-documents": lambda size: "cat <<A\n" * (size // 8) + VALID,
    "here-documents that end": lambda size: "cat <<A\nA\n" * (size // 10) + VALID,
    "labels": lambda size: "[PYTHON]" * (size // 8) + VALID,
    "spaces of Unicode": lambda size: "\u00a0" * size + "x\n" + VALID,
    "sentences": lambda size: "```\n" + "a b\n" * (size // 4) + VALID,
    "one long word": lambda size: f"```\n{VALID}\nimport {'a' * size}.b c",
    "one long line": lambda size: f"{fenced(VALID)}\n{CLASS}  if {'self.a ' * (size // 7)}\n",
    "class statements": lambda size: f"{fenced(VALID)}\n{CLASS * (size // 37)}",
    "class statements on a line": lambda size: f"{fenced(VALID)}\n{'class ImageRegressionCNN(' * (size // 25)}\n",
    "statements": lambda size: f"{fenced(VALID)}\n{CLASS}" + "  self.a = 1 1\n" * (size // 15),
    "rows": lambda size: f"{fenced(VALID)}\n{CLASS}" + "| " * (size // 2) + "x\n",
    "stars": lambda size: fenced("from torch.nn import *\n" * (size // 23) + VALID),
    "compiled": lambda size: fenced("@torch.compile\n" * (size // 15) + VALID),
    "compiled in each other": lambda size: fenced(VALID + "x = " + "torch.compile(" * 40 + "1" + ")" * 40 + "\n"),
    "compiled one by one": lambda size: fenced(VALID + "a = torch.compile(b)\n" * (size // 21)),
    "aliases": lambda size: fenced("class A:\n    pass\n" + "ImageRegressionCNN = A\n" * (size // 23)),
    "scopes": lambda size: fenced("q = 1\n") + "\n" + fenced(VALID + ("lambda: " * 60 + "[a, b, c]\n") * (size // 490)),
}

#: Answers of which every line could begin a stretch of code.
STARTS = [
    "import a b\n",
    "A = (\n",
    "A = (1,\n",
    "@a\n",
    "class A(\n",
    f"{CLASS} x y\n",
    "    class A:\nx y\n",
    "A = 1<a>\n",
    'A = """\n',
]


def read(text: str) -> str | Rejection:
    """Read an answer as the search's process does."""
    source = extracted(completion(text), contract())
    return source if isinstance(source, Rejection) else rejection_of(source, contract()) or source


def calls(text: str) -> int:
    """Count the calls of functions while an answer is read."""
    counted = 0

    def count(_frame: Any, event: str, _argument: Any) -> None:
        nonlocal counted
        counted += event in ("call", "c_call")

    sys.setprofile(count)
    try:
        read(text)
    finally:
        sys.setprofile(None)
    return counted


def chain(length: int) -> str:
    """Write a class whose constant is defined over so many blocks, each of which lacks the one before it."""
    links = [fenced(f"A{i + 1} = A{i}\n") for i in reversed(range(length))]
    return "\n".join([fenced("A0 = 4\n"), *links, fenced(VALID.replace("4", f"A{length}"))])


@pytest.mark.few(6)
@pytest.mark.parametrize("write", SLOW.values(), ids=SLOW)
def test_sixteen_times_the_text_does_not_cost_a_hundred_times_as_much(write: Callable[[int], str]) -> None:
    """Counted in calls; a cost that grows as the square would be 256 times as high."""
    assert calls(write(16_000)) < 100 * calls(write(1_000))


def test_blocks_that_lack_each_other_cost_as_many_steps_as_there_are() -> None:
    """Counted in calls, so it is the same on every machine; a cost that grows as the square would double the ratio."""
    assert calls(chain(80)) < 2.5 * calls(chain(40)) < 6.25 * calls(chain(20))
    assert source_of(chain(80)).startswith("A0 = 4\n\nA80 = A79\n\n")


@pytest.mark.timeout(120)
def test_name_that_repeats_is_looked_for_once() -> None:
    """A pattern that tries each place of the name with every other one would take minutes."""
    text = f"class {'ImageRegressionCNN' * 25_000}x"
    chosen = Known.of([ParsedCode(VALID, ast.parse(VALID))], written=VALID, was="")
    assert later_version(text, chosen, "ImageRegressionCNN", BlockParser()) is None


def test_number_of_blocks_is_bounded() -> None:
    """An answer with as many blocks as this was not written by a model that answers."""
    chained = read(chain(1_200))
    assert isinstance(chained, Rejection)
    assert chained.reason is Reason.too_complex
    helpers = "\n".join([fenced("x = 1\n")] * (blocks.MOST_BLOCKS - 1))
    assert source_of(f"{helpers}\n{fenced(VALID)}") == VALID
    more = read(f"{helpers}\n{fenced(VALID)}\n{fenced('x = 1' + chr(10))}")
    assert isinstance(more, Rejection)
    assert more.reason is Reason.too_complex


@pytest.mark.few(4)
@pytest.mark.parametrize("line", STARTS)
def test_characters_that_are_parsed_are_bounded(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every attempt to find code counts."""
    parsed: list[int] = []

    def parse(text: str) -> ast.Module:
        parsed.append(len(text))
        return parse_python(text)

    monkeypatch.setattr(problems, "parse_python", parse)
    extracted(completion(f"It's:\n{line * (90_000 // len(line))}{VALID}"), contract())
    assert 90_000 < sum(parsed) <= blocks.MOST_PARSED


def test_answer_that_takes_too_much_parsing_is_rejected() -> None:
    """The class may stand in the part that was not read."""
    verdict = read(f"You gave:\n{fenced(VALID)}\nIt's:\n{STARTS[0] * 8_000}{VALID}")
    assert isinstance(verdict, Rejection)
    assert verdict.reason is Reason.too_complex
