"""Thoughts are not answers, tags and marks around code are not code, and within code all of them are text."""

import pytest
from gate_cases import VALID, fenced, refusal_of, source_of

from tacevo.records import Reason

DRAFT = VALID
NEW = VALID.replace("4", "8")
BROKEN = NEW.replace("num_outputs)\n\n", "num_outputs\n\n")

#: How a thought is opened and closed.
THOUGHTS = [
    ("<think>\n", "\n</think>"),
    ("<think>", "</think>"),
    ("<thinking>\n", "\n</thinking>\n"),
    ("<thought>\n", "\n</thought>\n"),
    ("<Think>\n", "\n</THINK>"),
    ('<thinking budget="high">\n', "\n</thinking>\n"),
    ("<think>\n<think>\n", "\n</think>\n"),  # the chat template wrote the first
    ("<thinking>\n<thought>\n", "\n</thought>\n</thinking>\n"),
    ("Okay. <think>", "</think>"),
    ("<reasoning>\n", "\n</reasoning>\n"),
    ("<reflection>\n", "\n</reflection>\n"),
    ("[THINK]", "[/THINK]"),
    ("[THINK]\n", "\n[/THINK]\n"),
    ("\u25c1think\u25b7\n", "\n\u25c1/think\u25b7\n"),
    ("&lt;think&gt;\n", "\n&lt;/think&gt;\n"),
    ("<|begin_of_thought|>\n", "\n<|end_of_thought|>\n"),
    ("<|channel|>analysis<|message|>", "<|end|><|start|>assistant<|channel|>final<|message|>"),
]

#: How a draft may stand in a thought.
DRAFTS = [
    "\n" + fenced(DRAFT),
    f"\n```python\n{DRAFT}",
    f"\nSo:\n\n{DRAFT.rstrip()}",
    f"\n{fenced(DRAFT.rstrip())}\nHm.",
]

MARKS = [
    "<|im_end|>",
    "<|eot_id|>",
    "</s>",
    "<end_of_turn>",
    "<|endoftext|>",
    "<eos>",
    "</answer> <|im_end|>",
    "</code></pre>",
]

#: Docstrings with what would be a fence, a thought or a mark elsewhere.
DOCSTRINGS = [
    "Small. <think> No thought. </think>",
    "Small. [THINK] Less <reasoning>, and no &lt;think&gt;.",
    "Small.\n\n    [/THINK]\n    ",
    "Small.\n\n    <think>\n    No thought.\n    ",
    "Small.\n\n    </think>\n    ",
    "Small.\n\n    ```python\n    net = ImageRegressionCNN()\n    ```\n    ",
    "Small.\n\n    ```\n    net = ImageRegressionCNN()\n    ```",
    "Small.\n\n    ~~~\n    Net\n    ~~~\n    ",
    "Ends in <|im_end|>\n    ",
    "Maps <image> to <force>\n    ",
]


@pytest.mark.parametrize(("opening", "closing"), THOUGHTS)
@pytest.mark.parametrize("draft", DRAFTS)
def test_draft_in_a_thought_is_not_the_answer(opening: str, closing: str, draft: str) -> None:
    """Neither where the answer has no class, nor where it is broken or cut off."""
    thought = f"{opening}An idea:{draft}{closing}"
    assert source_of(f"{thought}\n{fenced(NEW)}") == NEW
    assert source_of(f"{thought}{fenced(NEW)}") == NEW
    assert source_of(f"{thought}\n{NEW}") == NEW
    assert refusal_of(f"{thought}\nI will write it.").reason is Reason.no_class
    assert refusal_of(f"{thought}\n{fenced(BROKEN)}").reason is Reason.syntax
    assert refusal_of(f"{thought}\n```python\n{NEW[:-40]}", "max_tokens").reason is Reason.truncated


@pytest.mark.parametrize(("opening", "closing"), THOUGHTS)
@pytest.mark.parametrize("draft", DRAFTS)
def test_thought_that_is_not_closed_leaves_no_answer(opening: str, closing: str, draft: str) -> None:
    """Not even what stands before it, e.g. the network that the model was given."""
    for text in (f"{opening}An idea:{draft}\nHm", f"{fenced(DRAFT)}\n{opening}Better:{draft}\nHm"):
        assert refusal_of(text).reason is Reason.no_class
        assert refusal_of(text, "max_tokens").reason is Reason.truncated


@pytest.mark.parametrize(
    "closing", ["</think>", "</thinking>", "</Thought>", "[/THINK]", "\u25c1/think\u25b7", "&lt;/think&gt;"]
)
@pytest.mark.parametrize("draft", DRAFTS)
def test_closing_tag_alone_ends_a_thought(closing: str, draft: str) -> None:
    """The chat template opened it."""
    assert source_of(f"An idea:{draft}\n{closing}\n{fenced(NEW)}") == NEW
    assert refusal_of(f"An idea:{draft}\n{closing}\nI will write it.").reason is Reason.no_class


def test_nested_thought_does_not_close_the_outer_one() -> None:
    """A tag that begins a line opens one; a tag within a sentence is mentioned."""
    inner = f"<think>\nAn idea\n<think>\nAnother\n</think>\n{fenced(DRAFT)}\n"
    assert refusal_of(f"{inner}Hm").reason is Reason.no_class
    assert refusal_of(f"{inner}</think>\nI will write it.").reason is Reason.no_class
    assert source_of(f"{inner}</think>\n{fenced(NEW)}") == NEW
    assert source_of(f"<think>\nI may not write <think> here.\n</think>\n{fenced(NEW)}") == NEW


def test_thought_beside_the_answer_does_not_matter() -> None:
    """After the answer, empty, or only mentioned as inline code."""
    assert source_of(f"{fenced(NEW)}\n<think>\nIs {fenced(DRAFT)} better?\n</think>\nNo.") == NEW
    assert source_of(f"<think>\n\n</think>\n\n{NEW}") == NEW
    assert source_of(f"I left out `<think>` and `</think>`.\n{fenced(NEW)}\nNo `</think>`, no `<think>`.") == NEW


@pytest.mark.parametrize(
    "write", ["{}", "```python\n{}```", "It's this:\n\n{}\nIt's small.", "Hm.</think>\n```python\n{}```"]
)
@pytest.mark.parametrize("words", DOCSTRINGS)
def test_text_of_code_is_not_read(write: str, words: str) -> None:
    """A docstring comes out letter for letter."""
    code = NEW.replace("Tiny but trainable.", words)
    assert source_of(write.format(code)) == code


@pytest.mark.parametrize("write", ["{}", "```python\n{}```"])
@pytest.mark.parametrize(
    "line",
    [
        "# <think> small",
        "NOTE = '<think>'",
        "NOTE = '''\n<think>\n'''",
        "NOTE = '```'",
        "NOTE = '</s>'",
        "# </reasoning>",
        "NOTE = '[THINK]'",
    ],
)
def test_strings_and_comments_are_not_read(write: str, line: str) -> None:
    """At the top level, where nothing is indented."""
    code = f"{line}\n\n\n{NEW}"
    assert source_of(write.format(code)) == code


@pytest.mark.parametrize("mark", MARKS)
@pytest.mark.parametrize("space", ["", "\n", " "])
def test_end_mark_is_not_code(mark: str, space: str) -> None:
    """Behind the code, the fence, or a fence that the model left out."""
    code = NEW.rstrip()
    for text in (
        f"{code}{space}{mark}",
        f"It's this:\n\n{code}{space}{mark}\n\nIt's small.",
        f"{fenced(NEW)}{space}{mark}",
        f"{fenced(code)}{space}{mark}",
        f"```python\n{code}{space}{mark}\n```",
        f"```python\n{code}{space}{mark}",
        f"```python\n{code}{space}{mark}\nIt's small.",
    ):
        assert source_of(text) == NEW


@pytest.mark.parametrize(
    "text",
    [
        "<code>{}</code>",
        '<pre><code class="language-python">{}</code></pre>',
        "<answer>\n{}\n</answer>",
        "<answer>```python\n{}\n```</answer>",
        "```python\n<code>{}</code>\n```",
        "It's this: <code>\n{}</code>\nIt's small.",
        "<|im_start|>assistant\n{}<|im_end|>",
        "<|channel|>final<|message|>```python\n{}\n```<|return|>",
        "```python {}\n```",
        "``` {}\n```",
        "~~~py {}\n~~~",
        "Here: ```python\n{}\n```",
        "Here: ```python {}```",
        "```python title='net.py'\n{}\n```",
        "```python from the file\n{}\n```",
        "```python\n{}``` It's small.\n\n```python\nnet = ImageRegressionCNN()\n```",
        "```python\n{}```Done.",
        "```python\n```python\n{}\n```\n```",
        "```markdown\n# Net\n\n```python\n{}\n```\n```",
        "```bash\ncat > net.py <<'PY'\n{}\nPY\n```",
        "I drop the ```python fences\n\n{}",
        "'''python\n{}\n'''",
    ],
)
def test_fences_and_tags_are_found_as_models_leave_them(text: str) -> None:
    """On the line of the class, behind the last line, or within others."""
    assert source_of(text.replace("{}", NEW.rstrip())) == NEW


@pytest.mark.parametrize("first", [DRAFT.replace('trainable."""', "trainable."), "'''\n"])
def test_docstring_that_never_ends_hides_no_later_block(first: str) -> None:
    """Its fence closes as if nothing were quoted."""
    assert source_of(f"{fenced(first)}\nIt's better so:\n{fenced(NEW)}") == NEW


def test_mark_within_a_class_does_not_cut_it() -> None:
    """What is indented below still belongs to the class, so it fails."""
    code = NEW.replace("num_outputs)\n\n", "num_outputs)<br>\n\n")
    assert refusal_of(fenced(code)).reason is Reason.syntax
    assert refusal_of(f"It's this:\n\n{code}").reason is Reason.syntax
