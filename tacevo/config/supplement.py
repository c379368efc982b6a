"""The authors' own instructions and system prompts, out of the reader's copy of their supplement.

The supplement (docs/references.bib, `tacevo_supplement`) is one page of HTML. Nothing of it is kept in this project:
its text is not ours to hand on.
"""

from collections.abc import Mapping
from html.parser import HTMLParser
from pathlib import Path

import yaml

from tacevo.errors import ConfigError
from tacevo.records import Json

#: The headings of the page, by their ids, below which the instructions and the system prompt of a task stand, and the
#: number of instructions.
_SECTIONS = {
    "force": ("sec-force-prompts", "sec-force-sys", 20),
    "grating": ("sec-grating-prompts", "sec-grating-sys", 17),
}

#: The marks that the authors' prompt has for what we send in the user's turn, and what we write there.
_ELSEWHERE = {
    "{instruction_prompt}": "(see the instruction in the next message)",
    "{base_net_code}": "(see the parent network in the next message)",
}


#: Tags within a text that stand on lines of their own.
_BLOCKS = frozenset({"div", "li", "ol", "p", "ul"})


class _Page(HTMLParser):
    """Collects the texts of list items and of listings, whole, under each heading that has an id."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.texts: dict[tuple[str, str], list[str]] = {}
        self._section = ""
        self._open = ""
        self._depth = 0  # of tags of its kind within the text that is open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note headings, and begin a text, or a line of one."""
        if self._open:
            self._depth += tag == self._open
            self._end_line(tag)
            self.handle_data("\n" if tag == "br" else "")
            return
        known = {name: value or "" for name, value in attrs}
        if tag in {"h1", "h2", "h3"}:
            self._section = known.get("id", self._section)
        if tag == "li" or (tag == "div" and "listing-block" in known.get("class", "").split()):
            self._open = tag
            self.texts.setdefault((self._section, tag), []).append("")

    def handle_endtag(self, tag: str) -> None:
        """End a text, or a line of one."""
        self._end_line(tag)
        if tag == self._open and self._depth == 0:
            self._open = ""
        self._depth -= tag == self._open

    def handle_data(self, data: str) -> None:
        """Add to the text that is open."""
        if self._open:
            self.texts[self._section, self._open][-1] += data

    def _end_line(self, tag: str) -> None:
        """End the line before and after a block, where there is one."""
        text = self.texts[self._section, self._open][-1] if self._open else ""
        if tag in _BLOCKS and text and not text.endswith("\n"):
            self.handle_data("\n")


def read_supplement(path: Path, task: str, ours: Mapping[str, Json]) -> dict[str, str]:
    """Read a task's prompts, `force` or `grating`, out of the supplement.

    The page has nothing but mutations, so the rest of a library, as the instruction for a crossover, is `ours`. Where
    the authors' prompt holds the instruction and the parent's code, it refers to the next message, which has both.

    Returns:
        The texts of the files `instructions` (YAML) and `system` (a template, with `$` as `$$`).

    Raises:
        ConfigError: the file cannot be read, or is not that page.
    """
    place = f"--from-supplement {path}"
    page, (prompts, system, count) = _Page(), _SECTIONS[task]
    try:
        page.feed(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"a file that cannot be read ({error})", place=place, expected="a page of HTML") from error
    instructions = [" ".join(text.split()) for text in page.texts.get((prompts, "li"), []) if text.strip()]
    listings = page.texts.get((system, "div"), [])
    lacking = [mark for mark in _ELSEWHERE if len(listings) != 1 or listings[0].count(mark) != 1]
    if len(instructions) != count or lacking:
        got = f"{len(instructions)} instructions under #{prompts} and {len(listings)} prompts under #{system}"
        expected = f"{count} instructions, and one prompt with {' and '.join(_ELSEWHERE)}"
        remedy = "save the page itself (index.html of the authors' repository), and not what a browser shows of it"
        raise ConfigError(got, place=place, expected=expected, remedy=remedy)
    prompt = listings[0].strip().replace("$", "$$") + "\n"
    for mark, words in _ELSEWHERE.items():
        prompt = prompt.replace(mark, words)
    mutations = [{"id": f"supplement_{number}", "text": text} for number, text in enumerate(instructions, start=1)]
    library = {**ours, "mutations": mutations}
    return {"instructions": yaml.safe_dump(library, sort_keys=False, allow_unicode=True, width=110), "system": prompt}
