"""Promise: a report is one page that needs nothing beside it, and shows text as text."""

import re
from dataclasses import replace
from html.parser import HTMLParser

from hand_runs import closed, configured, run, trained
from matplotlib.figure import Figure

from analysis.report.figure_list import Picture
from analysis.report.plain_page import Image, as_html, drawn
from analysis.table import PValue, Table

TABLE = Table(name="t", caption="a < b", columns=("name", "p"), rows=(("<script>", PValue(0.0001)),), notes=("R & D",))
RUN = run([trained(0, 0)], [closed(0)])


class Tags(HTMLParser):
    """Remembers which tags a page opens and does not close, and where its links lead."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take an opened tag."""
        if tag not in {"meta", "img"}:
            self.open.append(tag)
        self.links += [value or "" for name, value in attrs if name in {"src", "href"}]

    def handle_endtag(self, tag: str) -> None:
        """Take a closed tag."""
        assert self.open.pop() == tag


def test_page_is_whole_and_links_to_nothing() -> None:
    """Every tag is closed in order, and every picture lies in the page itself."""
    page = as_html(RUN, [TABLE], [Image(caption="<c>", width=3.5, png=b"png")], ["missing: <x>"])
    tags = Tags()
    tags.feed(page)
    assert tags.open == []
    assert tags.links == ["data:image/png;base64,cG5n"]


def test_text_cannot_become_markup() -> None:
    """A candidate's text, a caption or a reason is shown, not obeyed."""
    page = as_html(RUN, [TABLE], [Image(caption="<c>", width=3.5, png=b"")], ["missing: <x>"])
    assert "<script>" not in page
    assert {"&lt;script&gt;", "a &lt; b", "R &amp; D", "missing: &lt;x&gt;"} <= set(re.split(r"<[^>]*>", page))


def test_first_lines_name_task_model_provider_and_data() -> None:
    """Whoever reads a figure below must know that no language model answered, and that no sensor was touched."""
    page = as_html(RUN, [TABLE], [], [])
    first = page.split("</h1>")[1].lstrip().splitlines()[0]
    assert first == "<p>Task: force. Model: grammar-1, provider: grammar. Data source: simulated.</p>"


def test_name_of_a_model_cannot_become_markup() -> None:
    """It comes from a configuration, which may be a stranger's."""
    strange = replace(RUN, config=configured(llm={"provider": "openai", "model": "<b>"}))
    assert "Model: &lt;b&gt;, provider: openai." in as_html(strange, [TABLE], [], [])


def test_picture_is_drawn_once_and_told() -> None:
    """Its caption and width come with it."""
    told: list[str] = []
    picture = Picture(name="empty", caption="Nothing.", draw=lambda: Figure(figsize=(3.5, 1)))
    image = drawn(picture, told.append)
    assert (told, image.caption, image.width) == (["empty"], "Nothing.", 3.5)
    assert image.png.startswith(b"\x89PNG")
