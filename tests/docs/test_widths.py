"""Promise: a block of code on a page is read whole, in 80 columns, and coloured by its language."""

import re
from pathlib import Path

import pytest
from test_docs_commands import PAGES

from tacevo.cli.signature import WIDTH

#: A block between fences, with its language, or of indented lines below an empty one.
FENCED = re.compile(r"^```(.*)\n((?:.*\n)*?)```$", re.MULTILINE)
INDENTED = re.compile(r"(?<=\n\n)(?: {4}.*\n)+", re.MULTILINE)

PAGES_LAID_OUT = [page for page in PAGES if page.name != "CHANGELOG.md" and "plans" not in page.parts]


@pytest.mark.parametrize("page", PAGES_LAID_OUT, ids=lambda page: f"{page.parent.name}/{page.name}")
def test_block_of_a_page_fits_its_column(page: Path) -> None:
    """No line is longer than 80 characters, every block is fenced, and every fence names its language."""
    text = page.read_text(encoding="utf-8")
    blocks = FENCED.findall(text)
    assert [language for language, _ in blocks if not language] == []
    assert [line for _, block in blocks for line in block.splitlines() if len(line) > WIDTH] == []
    assert INDENTED.findall(re.sub(r"(?m)^(?:[-*]|\d+\.) .*(?:\n(?: .*)?)*", "", FENCED.sub("", text))) == []
