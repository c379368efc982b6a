"""Promise: the page is one file that needs nothing beside it, and no text in it can become markup or script."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from pages import HOSTILE, page_of_shipped_run, poisoned

import analysis.report.page.html as page_html
from analysis.report.page.html import SCRIPTS, as_data, as_html, json_in_html
from analysis.report.page.whole import PageContents
from tacevo.records import to_json

PARTS = Path(page_html.__file__).parent


@pytest.fixture(scope="module")
def shipped() -> PageContents:
    """Return the page of a shipped run."""
    return page_of_shipped_run()


@pytest.fixture(scope="module")
def hostile(shipped: PageContents) -> PageContents:
    """Return the same with hostile texts."""
    return poisoned(shipped)


class Elements(HTMLParser):
    """Collects a page's elements and attributes as a browser's parser sees them."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take an element."""
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]


def policy_of(page: str) -> dict[str, str]:
    """Read the page's policy, by directive."""
    (policy,) = (value for name, value in Elements(page).attributes if name == "content" and "default-src" in value)
    return dict(rule.split(" ", 1) for rule in policy.split("; "))


@pytest.mark.slow
def test_hostile_texts_add_no_element(shipped: PageContents, hostile: PageContents) -> None:
    """The elements and attributes of the page are those of the same page with harmless texts."""
    calm, attacked = Elements(as_html(shipped)), Elements(as_html(hostile))
    assert attacked.tags == calm.tags
    assert attacked.tags.count("script") == 2
    assert not any(name.startswith("on") for name, _ in attacked.attributes)


def test_hostile_texts_come_whole_into_the_contents(hostile: PageContents) -> None:
    """What is shown is what came: the JSON between the tags is the contents, letter by letter."""
    page = as_html(hostile)
    inside = page.split('id="contents">')[1].split("</script>")[0]
    assert json.loads(inside) == json.loads(as_data(hostile)) == json.loads(json.dumps(to_json(hostile)))
    assert json.loads(inside)["title"].endswith(HOSTILE)


@pytest.mark.parametrize("text", ["</script>", "</SCRIPT ", "<!--", "-->", "]]>", "\u2028", "\ud800", "&amp;", "\x00"])
def test_contents_hold_no_letter_that_html_reads(text: str) -> None:
    """Nothing but ASCII without `<`, `>` and `&` enters the element, and the value stays what it was."""
    escaped = json_in_html(json.dumps(text))
    assert escaped.isascii()
    assert not set("<>&") & set(escaped)
    assert json.loads(escaped) == text


def test_policy_names_the_very_script_and_style(shipped: PageContents) -> None:
    """A browser runs the script only if the hash is that of its bytes between the tags; nothing else may be loaded."""
    page = as_html(shipped)
    policy = policy_of(page)
    for kind in ("script", "style"):
        (text,) = re.findall(rf"<{kind}>(.*?)</{kind}>", page, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert policy[f"{kind}-src"] == f"'sha256-{digest}'"
    assert policy["default-src"] == "'none'"
    assert policy["img-src"] == "data:"
    assert "connect-src" not in policy
    assert "unsafe" not in str(policy)


def test_page_links_to_nothing_outside(hostile: PageContents) -> None:
    """Every address in its markup is a place within it, or lies in it."""
    addresses = [value for name, value in Elements(as_html(hostile)).attributes if name in {"src", "href", "action"}]
    assert [address for address in addresses if not address.startswith(("#", "data:,"))] == []


def test_thousand_candidates_stay_below_15_megabytes(shipped: PageContents) -> None:
    """Counted as if none of a thousand had its source in common with another."""
    contents = len(as_data(shipped))
    fixed = len(as_html(shipped)) - contents
    assert fixed + 1_000 * contents / len(shipped.sources) < 15_000_000


def test_own_scripts_set_texts_only() -> None:
    """None of them writes markup, styles in attributes, or code made of text; D3 is not ours."""
    for name in SCRIPTS[1:]:
        text = (PARTS / name).read_text()
        assert not re.search(r"innerHTML|outerHTML|insertAdjacent|document\.write|\.html\(|eval|Function\(", text), name
        assert '"style"' not in text


def test_scripts_cannot_end_their_element() -> None:
    """Neither D3 nor a part of ours holds the letters that end a script, or open a comment in one."""
    for name in (*SCRIPTS, "style.css"):
        assert not re.search(r"</(script|style)|<!--", (PARTS / name).read_text(), re.IGNORECASE), name


def test_page_hands_on_the_licence_of_its_library(shipped: PageContents) -> None:
    """D3 may be copied only with its notice, which names its author."""
    assert (PARTS / "d3.min.js").read_text().startswith("// https://d3js.org v7")
    assert "Mike Bostock" in (PARTS / "d3.LICENSE").read_text()
    assert (PARTS / "d3.LICENSE").read_text() in as_html(shipped)
    assert "permission notice" in as_html(shipped)
