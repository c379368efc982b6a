"""Extraction finds the one source text in an answer, or says why there is none; it runs nothing."""

import json
from pathlib import Path
from textwrap import indent

import pytest
from checkout import SHARED
from gate_cases import VALID, completion, contract, examples, extracted, fenced, needs_shared, refusal_of, source_of
from hypothesis import given
from hypothesis import strategies as st

from tacevo.gate.extraction import extract, first_look
from tacevo.records import Reason, Rejection

CONTRACT = contract()
HELPER = "class Block(nn.Module):\n    def forward(self, x):\n        return x\n"
USING = VALID.replace("nn.Conv2d(in_channels, 4, 3)", "nn.Sequential(nn.Conv2d(in_channels, 4, 3), Block())")
OTHER = VALID.replace("4", "8")


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(VALID, id="bare"),
        pytest.param("\n\n" + VALID.rstrip(), id="blank lines around, none at the end"),
        pytest.param("\ufeff" + VALID.replace("\n", "\r\n"), id="byte order mark and Windows newlines"),
        pytest.param(indent(VALID, "    "), id="indented"),
        pytest.param(f"```python\n{VALID}```", id="fence"),
        pytest.param(f"```\n{VALID}```\n", id="fence without a language"),
        pytest.param(f"~~~~ py\n{VALID}~~~~\n", id="tildes"),
        pytest.param(f"Here it is:\n```python\n{VALID}", id="fence never closed"),
        pytest.param(f"1. The class:\n   ```python\n{indent(VALID, '   ')}   ```\n2. Done.", id="fence in a list"),
        pytest.param(f"```bash\npip install torch\n```\nThen:\n```python\n{VALID}```", id="shell fence before"),
        pytest.param(f"```python\n{VALID}```\n```python\nmodel = ImageRegressionCNN()\n```", id="usage fence after"),
        pytest.param(f"```text\n{VALID}```", id="fence marked as text"),
        pytest.param(f"Sure! Here's the class:\n\n{VALID}", id="prose before"),
        pytest.param(f"{VALID}\nI didn't change (much) else.", id="prose after"),
        pytest.param(f"It's ready.\n\n{VALID}\n## Notes\n- import of nn isn't needed\n- it's small", id="prose around"),
        pytest.param(f"The code:\n\n{indent(VALID, '    ')}\nThat is all.", id="indented code in prose"),
    ],
)
def test_source_is_found_in_any_wrapping(text: str) -> None:
    """Whatever stands around the class, the class alone comes out, letter for letter."""
    assert source_of(text) == VALID


def test_imports_helpers_and_constants_are_kept() -> None:
    """What stands with the class in one block belongs to it."""
    block = f"import torch\nfrom torch import nn\n\nWIDTH = 4\n\n\ndef act(x):\n    return x\n\n\n{HELPER}\n\n{USING}"
    assert source_of(f"Here:\n```python\n{block}```") == block
    assert source_of(f"I'd do this:\n\n{block}\n\nIt's done.") == block


@pytest.mark.parametrize(
    "text",
    [
        f"```python\n{HELPER}```\nand\n```python\n{USING}```",
        f"```\n{USING}```\n```\n{HELPER}```",
        f"{USING}\nIt needs a helper, that's this one:\n\n{HELPER}",
    ],
)
def test_helper_in_another_block_is_joined(text: str) -> None:
    """A block that defines a missing name goes before the class, wherever the answer put it."""
    assert source_of(text) == f"{HELPER.rstrip()}\n\n{USING}"


def test_helper_of_a_helper_is_joined() -> None:
    """Missing names are looked up until none is left."""
    block = HELPER.replace("return x", "return rescale(x)")
    function = "def rescale(x):\n    return 2 * x\n"
    text = "\n".join(map(fenced, (block, USING, function)))
    assert source_of(text) == f"{block.rstrip()}\n\n{function.rstrip()}\n\n{USING}"


def test_last_of_several_versions_counts() -> None:
    """A model that shows two versions in two blocks means the later one."""
    assert source_of(f"First:\n```python\n{VALID}```\nBetter:\n```python\n{OTHER}```") == OTHER
    assert source_of(f"First:\n\n{VALID}\nBut this is better:\n\n{OTHER}") == OTHER


@pytest.mark.parametrize(
    "again",
    [
        OTHER,
        "ImageRegressionCNN = nn.Identity",
        "from m import a as ImageRegressionCNN",
        "try:\n    pass\nexcept ValueError as ImageRegressionCNN:\n    pass",
        "match [1]:\n    case [*ImageRegressionCNN]:\n        pass",
        "match {}:\n    case {**ImageRegressionCNN}:\n        pass",
        "del ImageRegressionCNN",
    ],
)
def test_two_definitions_in_one_text_are_ambiguous(again: str) -> None:
    """Python would silently keep the last, so a reader and the machine would see different classes."""
    rejection = refusal_of(f"{VALID}\n\n{again}\n")
    assert rejection.reason is Reason.ambiguous
    assert "got 2, on lines 1, " in rejection.detail


@pytest.mark.parametrize(("text", "excess"), [(VALID, -1), (VALID + "# é\n", 4)])
def test_size_in_bytes_is_checked_first(text: str, excess: int) -> None:
    """Nothing else is done with a huge answer; a sign beyond ASCII counts as what it takes in UTF-8."""
    assert first_look(completion(text), limit=len(text.encode())) is None
    rejection = first_look(completion(text, "refusal"), limit=len(VALID) + excess)
    assert isinstance(rejection, Rejection)
    assert rejection.reason is Reason.too_long


@pytest.mark.parametrize(
    ("text", "stop_reason", "reason"),
    [
        ("", "end_turn", Reason.empty),
        (" \n\t\n", "end_turn", Reason.empty),
        ("I cannot help with that.", "refusal", Reason.refused),
        ("", "refusal", Reason.refused),
        ("", "invalid_request", Reason.invalid_request),
        ("", "max_tokens", Reason.truncated),
        ("class", "model_context_window_exceeded", Reason.truncated),
        ("I cannot help with that.", "end_turn", Reason.no_class),
        ("Sorry", "end_turn", Reason.no_class),
        ("x = '\ud800'", "end_turn", Reason.syntax),
        ("class A:\0\n", "end_turn", Reason.no_class),
    ],
)
def test_answer_without_code_has_its_own_reason(text: str, stop_reason: str, reason: Reason) -> None:
    """Blank, refused, and plain prose are told apart."""
    assert refusal_of(text, stop_reason).reason is reason


@pytest.mark.parametrize(
    "text",
    [
        "# ImageRegressionCNN, second generation\n" + VALID.replace("ImageRegressionCNN", "Net"),
        VALID.split("    def forward", maxsplit=1)[0],  # an excerpt alone cannot be run
    ],
)
def test_other_class_and_class_without_forward_are_no_class(text: str) -> None:
    """Neither is the network that was asked for."""
    assert refusal_of(text).reason is Reason.no_class


@pytest.mark.parametrize("wrap", ["{}", "```python\n{}```", "It's here:\n\n{}\nDone."])
def test_syntax_error_names_its_line(wrap: str) -> None:
    """A fault inside the class is never cut away, with fences or without."""
    rejection = refusal_of(wrap.format(VALID.replace("in_channels, 4, 3)", "in_channels, 4 3)")))
    assert rejection.reason is Reason.syntax
    assert rejection.detail.startswith("line 6: SyntaxError: ")


def test_mixed_tabs_are_a_syntax_error() -> None:
    """Python's own complaint reaches the reader."""
    rejection = refusal_of(VALID.replace("        self.head", "\tself.head"))
    assert rejection.reason is Reason.syntax
    assert "TabError" in rejection.detail


def test_deep_nesting_is_a_clean_rejection() -> None:
    """The parser's stack ends before the text does; and what is compared with a later version may be too deep, too."""
    rejection = refusal_of(VALID.replace("4, 3)", "4, " + "-" * 20_000 + "3)"))
    assert rejection.reason in (Reason.too_complex, Reason.syntax)
    deep = VALID.replace("4, 3)", "4, 3" + " + 0" * 2_500 + ")")
    assert source_of(fenced(deep)) == deep
    assert refusal_of(f"{fenced(deep)}\nSo ImageRegressionCNN is done.").reason is Reason.too_complex


@pytest.mark.parametrize("wrap", ["{}", "```python\n{}", "Here:\n\n{}"])
def test_class_cut_off_is_truncated(wrap: str) -> None:
    """At the token limit nobody can tell a whole class from the first part of one, even where it parses."""
    assert refusal_of(wrap.format(VALID), "max_tokens").reason is Reason.truncated
    assert refusal_of(wrap.format(VALID[:-30]), "max_tokens").reason is Reason.truncated


@pytest.mark.parametrize("text", [f"```python\n{VALID}```\nThis netw", f"{VALID}\nThis network's first lay"])
def test_class_closed_before_the_cut_counts(text: str) -> None:
    """What came after the class was lost, not the class."""
    assert source_of(text, "max_tokens") == VALID


@pytest.mark.parametrize(
    "wrap", ["```python\n{}```\nBetter:\n```python\n{}", "{}\nI'd do this:\n\n{}", "```python {}```\n{}"]
)
@pytest.mark.parametrize("end", [-20, len("class ImageRegressionCNN(nn.M")])
def test_better_version_cut_off_is_truncated(wrap: str, end: int) -> None:
    """The model was on its way to replace the first version, be it at its first line."""
    assert refusal_of(wrap.format(VALID, OTHER[:end]), "max_tokens").reason is Reason.truncated


def test_extraction_runs_nothing() -> None:
    """Statements beside the class stay text."""
    text = f"raise SystemExit(1)\n\n\n{VALID}"
    assert source_of(text) == text


@given(st.text(max_size=200))
def test_any_text_gets_an_answer(text: str) -> None:
    """No text makes extraction raise, alone or around a class."""
    assert isinstance(extract(completion(text), CONTRACT), Rejection)
    extract(completion(f"{text}\n{VALID}\n{text}"), CONTRACT)


LINES = [
    *VALID.split("\n"),
    "```",
    "```python",
    "It's prose (",
    '"""',
    "<think>",
    "</think>",
    "<|im_end|>",
    "Sure",
    "A = 4",
]


@given(st.lists(st.sampled_from([*LINES, VALID]), max_size=30))
def test_any_lines_get_an_answer(lines: list[str]) -> None:
    """No shuffling of code, fences, tags and prose makes extraction raise, and a source extracts to itself."""
    extracted_source = extract(completion("\n".join(lines)), CONTRACT)
    if isinstance(extracted_source, str):
        assert extract(completion(extracted_source), CONTRACT) == extracted_source


@needs_shared
@pytest.mark.parametrize("example", examples("llm_answers"), ids=lambda example: example["file"])
def test_real_answer_extracts_unless_cut_off(example: dict[str, str]) -> None:
    """Every real answer holds its class, but for the one that reached the token limit."""
    extracted_source = extracted(completion(example["response"], example["stop_reason"]), contract(example["task"]))
    assert isinstance(extracted_source, str) == (example["stop_reason"] == "end_turn")
    if isinstance(extracted_source, Rejection):
        assert extracted_source.reason is Reason.truncated


#: Why an answer of the shared set is rejected here; the others of these kinds have a source.
REJECTED = {
    "j1_surrogate": Reason.syntax,
    "j2_think_cut": Reason.truncated,
    "j3_think_unclosed_end": Reason.no_class,
    "j4_think_only_draft": Reason.no_class,
    "j5_think_final_cut": Reason.truncated,
    "j6_final_broken_draft_ok": Reason.syntax,
    "x14_nul": Reason.syntax,
    "x15_nbsp": Reason.syntax,
    "x16_zwsp": Reason.syntax,
    "x17_curly_quotes_code": Reason.syntax,
    "x19_search_replace": Reason.no_class,
    "x22_mixed_tabs": Reason.syntax,
    "x29_line_numbers": Reason.no_class,
    "x30_html_entities": Reason.syntax,
    "x34_wrong_name": Reason.no_class,
    "x36_two_defs_in_one_block": Reason.ambiguous,
    "x49_notebook": Reason.syntax,
    "x50_pip": Reason.syntax,
    "z01_parent_then_broken": Reason.syntax,
}


@needs_shared
@pytest.mark.parametrize("path", sorted((SHARED / "cases" / "answers").glob("[ejxz]*")), ids=lambda path: path.stem)
def test_odd_answer_gets_its_verdict(path: Path) -> None:
    """As small and as careless models leave their answers."""
    text, stop_reason = path.read_text(encoding="utf-8"), "end_turn"
    if path.suffix == ".json":
        text, stop_reason = json.loads(text)["response"], json.loads(text)["stop_reason"]
    extracted_source = extracted(completion(text, stop_reason), CONTRACT)
    assert (extracted_source.reason if isinstance(extracted_source, Rejection) else None) == REJECTED.get(path.stem)
