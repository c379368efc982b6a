"""What stands around code is no part of it: fences that never end, labels, CDATA, quotes, prompts, JSON, notebooks."""

import json
from collections.abc import Callable
from textwrap import indent

import pytest
from gate_cases import VALID, fenced, refusal_of, source_of

from tacevo.records import Reason

NAME = "ImageRegressionCNN"
NEW = VALID.replace("4", "8")
CODE = NEW.rstrip()
BROKEN = NEW.replace("nn.Linear(8, num_outputs)", "nn.Linear(8, num_outputs").rstrip()

#: Sentences as they stand behind code.
WORDS = {
    "sentence": "The conv sees more of each marker, and the mean keeps it small.",
    "two paragraphs": "It is small.\n\nIt sees more of each marker (8 channels), doesn't it?",
    "stars": "* wider conv\n* mean over all positions",
    "dashes": "- wider conv\n  - 8 channels\n- mean over all positions",
    "numbers": "1. wider conv\n2. mean over all positions",
    "heading": "## Why\n\nThe conv sees more of each marker.",
    "bold": "**Changes:** a wider conv.",
    "label": "Notes: a wider conv; nothing else.",
    "table": "| part | why |\n|---|---|\n| conv | wider |",
    "question": "Should I widen it further?",
    "rule": "---\nWider now.",
    "quoted word": "`conv` is wider now.",
    "for": "For three axes, it is enough.",
    "with": "With 8 channels it sees more.",
    "mark": "It is small.<|im_end|>",
    "words that begin as code": "import of nn isn't needed, and return values are forces.",
    "call in words": "forward(x) returns three forces (N, 3).",
    "equation in words": "loss = 0.02 on the validation images, I guess.",
    "link": "[See the docs](https://example.org).",
    "picture": "![net](net.png)",
    "mathematics": "$y = Wx + b$ at the end.",
    "other letters": "\u5c0f\u3055\u304f\u3066\u901f\u3044\u3067\u3059\u3002",
    "quote": "> It is small and quick.",
    "use": f"Usage:\n\nnet = {NAME}(3, 3)\nprint(net(torch.zeros(1, 3, 8, 8)).shape)",
    "use under a heading in bold": f"**Example usage:**\nnet = {NAME}()",
    "two backticks": "``\nIt is small and quick.",
}

#: How lines may be quoted, or typed in a session.
SIGNED = {
    "quoted": indent(CODE, "> ", lambda _: True),
    "quoted without spaces": indent(CODE, ">", lambda _: True),
    "quoted fence": indent(fenced(NEW), "> ", lambda _: True),
    "quoted with words": indent(f"It's this:\n\n{fenced(NEW)}\n\nIt's small.", "> ", lambda _: True),
    "quoted twice": indent(fenced(NEW), "> > ", lambda _: True),
    "quoted in a fence": fenced(indent(NEW, "> ", lambda _: True)),
    "quoted in a fence of text": fenced(indent(NEW, "> ", lambda _: True), "text"),
    "prompts": "\n".join([">>> " + CODE.split("\n")[0], *("... " + line for line in CODE.split("\n")[1:])]),
    "prompts in a fence": fenced(indent(NEW, "... ", lambda _: True).replace("...", ">>>", 1)),
    "prompts in a session's fence": fenced(indent(NEW, "... ", lambda _: True).replace("...", ">>>", 1), "pycon"),
    "only first prompts": fenced(indent(NEW, ">>> ", lambda _: True)),
    "short prompts": fenced("\n".join(f"... {line}".rstrip() for line in NEW.split("\n")).replace("...", ">>>", 1)),
    "session with use": fenced(
        ">>> import torch\n"
        + indent(NEW, "... ", lambda _: True).replace("...", ">>>", 1)
        + f"... \n>>> net = {NAME}()\n>>> print({NAME}())\n{NAME}(\n  (conv): Conv2d(3, 8)\n)\n"
    ),
    "session with output": (
        indent(NEW, "... ", lambda _: True).replace("...", ">>>", 1) + f"...\n>>> {NAME}()(x).shape\ntorch.Size([2, 3])"
    ),
    "quoted with blank lines": "\n".join(f"> {line}" if line else "" for line in fenced(NEW).split("\n")),
    "IPython": "In [1]: " + CODE.replace("\n", "\n   ...: ") + f"\n\nIn [2]: {NAME}()\nOut[2]: ...",
    "quoted session": indent(
        fenced(indent(NEW, "... ", lambda _: True).replace("...", ">>>", 1)), "> ", lambda _: True
    ),
}

CALL = {"name": "write_file", "arguments": {"path": "net.py", "content": NEW}}
NOTEBOOK = {
    "cells": [
        {"cell_type": "markdown", "metadata": {}, "source": ["# Net\n", "It is small."]},
        {"cell_type": "code", "execution_count": None, "outputs": [], "source": NEW.splitlines(keepends=True)},
        {"cell_type": "code", "outputs": [], "source": [f"net = {NAME}()\n", "print(net(torch.zeros(1, 3, 48, 48)))"]},
    ],
    "metadata": {"kernelspec": {"name": "python3"}},
    "nbformat": 4,
}

#: JSON with the source as its only long text.
JSON = {
    "object": json.dumps({"code": NEW}),
    "object with words": json.dumps({"reason": "it is smaller and sees more", "code": NEW, "confidence": 0.7}),
    "object with lines": json.dumps({"reason": "smaller", "code": NEW}, indent=2),
    "object in a fence": fenced(json.dumps({"code": NEW}) + "\n", "json"),
    "object in a fence without a language": fenced(json.dumps({"code": NEW}, indent=1) + "\n", ""),
    "object between words": f"It's this:\n\n{json.dumps({'code': NEW})}\n\nIt's small.",
    "object in a fence between words": f"It's:\n\n{fenced(json.dumps({'code': NEW}) + chr(10), 'json')}\n\nIt's small.",
    "call": json.dumps(CALL),
    "list of calls": json.dumps([CALL]),
    "call with a text of arguments": json.dumps(
        {"function": {"name": "write", "arguments": json.dumps({"code": NEW})}}
    ),
    "call between tags": f"<tool_call>\n{json.dumps(CALL)}\n</tool_call>",
    "call behind a tag": f"<tool_call>{json.dumps(CALL)}</tool_call>",
    "call behind a label": f"[TOOL_CALLS]{json.dumps([CALL])}",
    "two calls": json.dumps({"path": "notes.md", "content": "Smaller."}) + "\n" + json.dumps(CALL),
    "list of lines": json.dumps({"code": CODE.split("\n")}),
    "markdown in it": json.dumps({"answer": f"It's this:\n\n{fenced(NEW)}\n\nIt's small."}),
    "raw newlines": json.dumps({"code": NEW}).replace("\\n", "\n"),
    "test beside it": json.dumps({"code": NEW, "test": f"class Test{NAME}:\n    def test(self):\n        {NAME}()\n"}),
    "answer of a server": json.dumps(
        {"choices": [{"message": {"tool_calls": [{"function": {"arguments": json.dumps({"code": NEW})}}]}}]}
    ),
    "blocks of a server": json.dumps([{"type": "text", "text": "So."}, {"type": "tool_use", "input": {"code": NEW}}]),
    "call behind a mark": f"<|python_tag|>{json.dumps(CALL)}",
    "object behind words": f"The call: {json.dumps(CALL)} That is all.",
    "object in a fence that never ends": f"```json\n{json.dumps({'code': NEW})}\n\nIt is small and quick.",
    "files": json.dumps({"files": {"net.py": NEW, "test.py": f"from net import {NAME}\n"}}),
    "behind a thought": f"<think>\n{fenced(VALID)}\n</think>\n{json.dumps({'code': NEW})}",
    "notebook": json.dumps(NOTEBOOK),
    "notebook with lines": json.dumps(NOTEBOOK, indent=1),
    "notebook in a fence": fenced(json.dumps(NOTEBOOK, indent=1) + "\n", "json"),
    "notebook of texts": json.dumps({"cells": [{"cell_type": "code", "source": NEW}]}),
    "list of lines alone": json.dumps(NEW.split("\n")),
    "fenced list of lines": fenced(json.dumps(NEW.split("\n"), indent=1) + "\n", "json"),
}

#: What else may stand around code.
AROUND = {
    "CDATA": "<network><![CDATA[\n{}\n]]></network>",
    "CDATA on its line": "<network><![CDATA[{}]]></network>",
    "CDATA in a document": '<?xml version="1.0"?>\n<answer>\n<code><![CDATA[\n{}\n]]></code>\n</answer>',
    "CDATA between words": "It's this:\n<source>\n<![CDATA[\n{}\n]]>\n</source>\nIt's small.",
    "CDATA in a fence": "```xml\n<code><![CDATA[\n{}\n]]></code>\n```",
    "here-document": "cat > net.py <<'END'\n{}\nEND",
    "here-document before words": "cat > net.py <<'EOF'\n{}\nEOF\n\nThen run it.",
    "here-document without quotes": "cat <<EOF > net.py\n{}\nEOF\n",
    "here-document of tee": "tee net.py <<EOF\n{}\nEOF\n",
    "here-document of python": "python - <<'PY'\n{}\nPY\n",
    "here-document of a prompt": "$ cat > net.py << 'PY'\n{}\nPY\n$ python net.py",
    "here-document in a fence": "```bash\ncat > net.py <<'PY'\n{}\nPY\n```",
    "here-document in a bare fence": "```\ncat <<'PY' | tee net.py\n{}\nPY\n```",
    "two here-documents": "cat > net.py <<'E'\n{}\nE\ncat > test.py <<'E'\nfrom net import ImageRegressionCNN\nE\n",
    "two here-documents in a fence": (
        "```bash\nmkdir a\ncat > net.py <<'E'\n{}\nE\ncat > test.py <<'E'\nfrom net import ImageRegressionCNN\nE\n```"
    ),
    "here-string": "@'\n{}\n'@ | Set-Content net.py",
    "command of a notebook": "%%writefile net.py\n{}",
    "here-document never ended": "cat > net.py <<'END'\n{}",
    "here-document in a Python fence": "```python\ncat > net.py <<'END'\n{}\nEND\n```",
    "square label": "[PYTHON]\n{}",
    "square label closed": "[PYTHON]\n{}\n[/PYTHON]",
    "square label on its line": "[PYTHON]{}",
    "square label in a fence": "```python\n[PYTHON]\n{}\n```",
    "square label of two words": "[BEGIN CODE]\n{}\n[END CODE]",
    "small square label": "[python]\n{}",
    "square label behind": "{}\n[END]",
    "square label of a file": "[net.py]\n{}",
    "curly label": "{{code}}\n{}\n{{code}}",
    "curly label with a language": "{{code:python}}\n{}",
    "angle label": "<python>\n{}",
    "word label": "BEGIN\n{}\nEND",
    "label with underscores": "START_OF_CODE\n{}",
    "label of words": "BEGIN PYTHON\n{}\nEND PYTHON",
    "label of dashes": "---BEGIN CODE---\n{}\n---END CODE---",
    "link": "[net.py](net.py)\n{}",
    "BBCode": "[code=python]\n{}\n[/code]",
    "AsciiDoc": "[source,python]\n----\n{}\n----",
    "reStructuredText": ".. code-block:: python\n\n{}",
    "equals signs": "=== net.py ===\n{}\n=== end ===",
    "colons": ":::python\n{}\n:::",
    "LaTeX": "\\begin{{lstlisting}}\n{}\n\\end{{lstlisting}}",
    "quotes never closed": "'''python\n{}",
}


@pytest.mark.parametrize("words", WORDS.values(), ids=WORDS)
@pytest.mark.parametrize("fence", ["```python", "```", "~~~py", "Here:\n\n```python"])
def test_sentences_behind_a_fence_that_never_ends_are_not_code(words: str, fence: str) -> None:
    """They stand behind a blank line, and parse as nothing."""
    assert source_of(f"{fence}\n{NEW}\n{words}") == NEW
    sign = fence.rsplit("\n", maxsplit=1)[-1][:3]
    assert source_of(f"{fence}\n{NEW}\n{words}\n\n{sign}python\nnet = {NAME}()\n{sign}") == NEW


@pytest.mark.parametrize("words", WORDS.values(), ids=WORDS)
def test_sentences_hide_no_fault_and_no_later_version(words: str) -> None:
    """Only what is no code is left out."""
    assert refusal_of(f"```python\n{BROKEN}\n\n{words}").reason is Reason.syntax
    assert refusal_of(f"{fenced(VALID)}\n```python\n{BROKEN}\n\n{words}").reason is Reason.syntax
    assert source_of(f"```python\n{VALID}\n{words}\n```python\n{NEW}\n{words}") == NEW
    assert refusal_of(f"```python\n{VALID}\n{words}\n\n{fenced(BROKEN + chr(10))}").reason is Reason.syntax


@pytest.mark.parametrize(
    "code",
    [
        "def act(x):\nreturn x",
        "x = F.relu(",
        "class Block(nn.Module):\n  def forward(self",
        "self.x = 1 1",
        "for x in y:\nz z",
        "@decorated(",
    ],
)
def test_code_that_does_not_parse_is_not_taken_for_sentences(code: str) -> None:
    """Half of the source would be lost."""
    assert refusal_of(f"```python\n{NEW}\n{code}").reason is Reason.syntax
    assert refusal_of(f"```python\n{code}\n{NEW}").reason is Reason.syntax


def test_fence_that_never_ends_is_cut_off_like_any_other() -> None:
    """A sentence behind the class shows that it was finished."""
    assert refusal_of(f"```python\n{NEW}", "max_tokens").reason is Reason.truncated
    assert refusal_of(f"```python\n{NEW[:-30]}", "max_tokens").reason is Reason.truncated
    assert refusal_of(f"```python\n{NEW}\ndef act(x", "max_tokens").reason is Reason.truncated
    assert source_of(f"```python\n{NEW}\nThe conv sees mo", "max_tokens") == NEW


@pytest.mark.parametrize("text", SIGNED.values(), ids=SIGNED)
@pytest.mark.parametrize(
    "write", ["{}", "It's this:\n\n{}\n\nIt's small.", "You gave:\n" + fenced(VALID) + "\nNow:\n\n{}"]
)
def test_signs_of_quotes_and_sessions_are_not_code(text: str, write: str) -> None:
    """What is typed is code, what is printed or shows the use is not."""
    assert source_of(write.format(text)) in (NEW, f"import torch\n\n{NEW}")


@pytest.mark.parametrize(
    "code",
    [
        NEW.replace(
            "Tiny but trainable.",
            "Small.\n\n    >>> net = ImageRegressionCNN()\n    >>> class A:\n    ...     b = 1\n    ",
        ),
        NEW.replace("Tiny but trainable.", "Small.\n\n    > class A:\n    > def b(\n    "),
        NEW.replace("Tiny but trainable.", 'Small: {"code": "class ImageRegressionCNN(nn.Module):"}'),
        NEW.replace("Tiny but trainable.", "Small: [PYTHON] <![CDATA[ a ]]>"),
        NEW.replace("in_channels, 8, 3)", "in_channels, [WIDTH][0], 3)"),
    ],
)
@pytest.mark.parametrize("write", ["{}", "```python\n{}```", "It's:\n\n{}\nIt's small."])
def test_code_that_looks_like_a_frame_is_kept(code: str, write: str) -> None:
    """Letter for letter."""
    assert source_of(write.replace("{}", code)) == code


@pytest.mark.parametrize("text", JSON.values(), ids=JSON)
def test_json_with_one_source_is_read(text: str) -> None:
    """An object, a call of a tool, a notebook; what stands beside the class is an example."""
    assert source_of(text) == NEW
    assert source_of(f"You gave:\n{fenced(VALID)}\nNow:\n\n{text}") == NEW


def test_json_with_two_sources_or_half_of_one_is_not_read() -> None:
    """Nobody knows which one the model meant; the later call of a tool counts."""
    assert refusal_of(json.dumps({"old": VALID, "new": NEW})).reason is Reason.no_class
    assert source_of(json.dumps([{"code": VALID}, {"code": NEW}])) == NEW
    assert refusal_of(json.dumps({"code": NEW})[:-40]).reason in (Reason.no_class, Reason.syntax)
    assert refusal_of(json.dumps({"code": NEW})[:-40], "max_tokens").reason is Reason.truncated
    assert refusal_of(json.dumps({"code": BROKEN})).reason is Reason.syntax
    assert refusal_of(f"{fenced(VALID)}\n{json.dumps({'code': BROKEN})}").reason is Reason.syntax


def test_cells_of_a_notebook_are_joined_like_blocks() -> None:
    """An import that the class lacks comes with it."""
    using = NEW.replace("F.relu", "reduce")
    cells = [{"cell_type": "code", "source": "from functools import reduce"}, {"cell_type": "code", "source": using}]
    assert source_of(json.dumps({"cells": cells})) == f"from functools import reduce\n\n{using}"


@pytest.mark.parametrize("write", [fenced, "{}".format])
def test_cell_that_writes_a_file_is_read(write: Callable[[str], str]) -> None:
    """A model writes it as it would stand in a notebook; a fault in it stays one."""
    assert source_of(write(f"%%writefile net.py\n{NEW}")) == NEW
    assert refusal_of(fenced(f"%%writefile net.py\n{BROKEN}\n")).reason is Reason.syntax


@pytest.mark.parametrize("text", AROUND.values(), ids=AROUND)
def test_labels_around_code_are_not_code(text: str) -> None:
    """Whether or not they are closed."""
    assert source_of(text.format(CODE)) == NEW
    assert source_of(f"You gave:\n{fenced(VALID)}\nNow:\n\n{text.format(CODE)}") == NEW
    reason = refusal_of(f"You gave:\n{fenced(VALID)}\nNow:\n\n{text.format(BROKEN)}").reason
    assert reason in (Reason.syntax, Reason.no_class)


@pytest.mark.parametrize(
    "space", ["\u00a0", "\u2002", "\u2003", "\u2009", "\u202f", "\u205f", "\u3000", "\u1680"], ids=ascii
)
@pytest.mark.parametrize("write", ["{}", "```python\n{}```", "It's:\n\n{}\nIt's small.", "```\n{}```"])
def test_spaces_of_unicode_indent(space: str, write: str) -> None:
    """All of the indentation, or every second of its spaces, as web pages have it."""
    lines = [line.lstrip(" ") for line in NEW.split("\n")]
    widths = [len(line) - len(line.lstrip(" ")) for line in NEW.split("\n")]
    for fill in (space, f"{space} ", f" {space}"):
        code = "\n".join((fill * width)[:width] + line for width, line in zip(widths, lines, strict=True))
        assert source_of(write.format(code)) == NEW


@pytest.mark.parametrize("forward", ["forward = run", "forward: object = run", "forward = lambda self, x: self.run(x)"])
def test_forward_may_be_given_by_an_assignment(forward: str) -> None:
    """In the class, in its constructor or behind it."""
    code = f"{NEW.replace('def forward', 'def run')}\n    {forward}\n"
    assert source_of(fenced(code)) == code
    assert (
        source_of(f"{fenced(code)}\n{fenced('class ' + NAME + '(nn.Module):' + chr(10) + '    ...' + chr(10))}") == code
    )


@pytest.mark.parametrize("line", ["{name}.forward = {name}.run", 'setattr({name}, "forward", {name}.run)'])
def test_forward_may_be_given_beside_the_class(line: str) -> None:
    """It is an assignment, too."""
    code = f"{NEW.replace('def forward', 'def run')}\n\n{line.format(name=NAME)}\n"
    assert source_of(fenced(code)) == code
    inside = NEW.replace("def forward", "def run").replace(
        "__init__()\n", "__init__()\n        self.forward = self.run\n"
    )
    assert source_of(fenced(inside)) == inside
    assert refusal_of(fenced(NEW.replace("def forward", "def run"))).reason is Reason.no_class
