"""Promise: Markdown shows a stranger's text, and obeys none of it, wherever the text stands."""

import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rendered import HOSTILE, meant, skeleton, words

from tacevo.text import as_code, in_markdown, on_a_line, plain

#: Pages with a place for a text.
PLACES = {
    "a paragraph": "{}",
    "a sentence": "Of {}.",
    "a heading": "# {}",
    "an item": "- {}\n- other",
    "a cell": "| head | other |\n|---|---|\n| {} | 1 |",
    "a head": "| {} | other |\n|---|---|\n| a | 1 |",
    "a caption": "**Of {} all**",
    "a link": "- [a {}](file.md): {}",
    "below a line": "Above\n{}",
}

#: Marks, letters, digits and spaces of every kind.
TEXTS = st.text("ab1wW .()-+=_*`~[]!<>&#;:/\\|$^@{}\"'%,?\n\t\r\u00a0\u2028é", min_size=1, max_size=24)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("text", HOSTILE)
def test_text_of_a_stranger_is_text_wherever_it_stands(text: str, place: str) -> None:
    """The page is made of what it would be made of with an honest word; an image's mark ends nothing, either."""
    page = PLACES[place]
    shown = page.replace("{}", in_markdown(f"x {text} y"))
    assert skeleton(shown) == skeleton(page.replace("{}", "word"))
    assert words(in_markdown(text)) == on_a_line(text)
    assert meant(in_markdown(text)) == ""


@pytest.mark.parametrize(
    ("paragraph", "expected"),
    [
        ("**Bold** and *slanted*, `code` and `**kept**`.", "Bold and slanted, code and **kept**."),
        ("val_loss of 2 * 3 * 4 in <b>", "val_loss of 2 * 3 * 4 in <b>"),
        ("See [the page](https://a.b/c) or <https://d.e>.", "See the page (https://a.b/c) or https://d.e."),
        (r"\*not\* \`marked\`", "*not* `marked`"),
    ],
)
def test_paragraph_without_its_marks(paragraph: str, expected: str) -> None:
    """Emphasis and code lose their marks, links keep their address, and what only looks like a mark stays."""
    assert plain(paragraph) == expected


@given(TEXTS)
def test_what_was_made_harmless_for_markdown_is_plain_again(text: str) -> None:
    """A text that a summary holds is on a terminal what it was."""
    assert on_a_line(plain(f"x {in_markdown(text)} y")) == on_a_line(f"x {text} y")


@given(TEXTS)
@example("w.www.x")
@example("a_b _c_ d__e")
def test_no_text_is_obeyed(text: str) -> None:
    """Whatever marks it has, at the ends of a line and between words."""
    if not on_a_line(text):
        return
    written = in_markdown(text)
    assert words(written) == on_a_line(text)
    for page in PLACES.values():
        assert skeleton(page.replace("{}", written)) == skeleton(page.replace("{}", "word"))


@given(TEXTS)
def test_code_within_a_line_ends_where_it_ends(text: str) -> None:
    """However many backticks it has in a row."""
    page = f"of {as_code(text)} all"
    kinds = [kind for kind, _ in skeleton(page)]
    if on_a_line(text):
        assert kinds == ["paragraph_open", "text", "code_inline", "text", "paragraph_close"]
        assert words(page) == " ".join(f"of {on_a_line(text)} all".split())


@pytest.mark.parametrize(
    "text",
    [
        "shear_yaw_deg",
        "0.35 mm (wide), 95 % of 3-4: p <0.001",
        "TacEvo run force-variants: architecture search, task force",
        "elites4-seeds20-epochs50-0a1b2c3d",
        "Fx in N; r2 -0.5 or 1.5e-05",
    ],
)
def test_honest_text_stays_as_it_is(text: str) -> None:
    """So that the source of a page can be read, too."""
    assert in_markdown(text) == text


def test_control_characters_become_escapes() -> None:
    """Those that turn a line or clear a terminal among them; every kind of white space is one space."""
    assert in_markdown("a\x1b[2J\u202eb") == r"a\\x1b\[2J\\u202eb"
    assert on_a_line(" a\r\n\t\u2028 b ") == "a b"
    assert re.search(r"[\x00-\x1f]", as_code("a\x1b\n")) is None
