"""Promise: docs/index.md leads to every page, and the pages for newcomers name things that exist."""

import re
from pathlib import Path

import pytest
from checkout import ROOT

DOCS = ROOT / "docs"

#: Pages that a newcomer follows to the code.
GUIDES = ("CONTRIBUTING.md", "docs/glossary.md")


def links(page: Path) -> list[str]:
    """List what a page links to, without addresses of other sites and places within a page."""
    targets = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    return [link for link in targets if "://" not in link]


def test_index_lists_every_page_once() -> None:
    """Whatever lies in docs/ has exactly one line in the index."""
    listed = sorted(link for link in links(DOCS / "index.md") if not link.startswith("../"))
    tutorials = [f"tutorials/{path.name}" for path in (DOCS / "tutorials").iterdir()]
    beside = [path.name for path in DOCS.iterdir() if path.name not in ("index.md", "tutorials")]
    assert listed == sorted(tutorials + beside)


@pytest.mark.parametrize("page", ["README.md", "docs/index.md", *GUIDES])
def test_links_lead_to_files(page: str) -> None:
    """A page for newcomers has no dead link."""
    place = (ROOT / page).parent
    assert [link for link in links(ROOT / page) if not (place / link).exists()] == []


@pytest.mark.parametrize("page", GUIDES)
def test_named_modules_and_configs_exist(page: str) -> None:
    """Who follows the guide finds each file; a module may be named without its ending, and NAME stands for yours."""
    text = (ROOT / page).read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:analysis|benchmarks|conf|docs|tacevo|tests/golden)/[\w./]+)`", text))
    assert named
    missing = [name for name in named if not ((ROOT / name).exists() or (ROOT / f"{name}.py").exists())]
    assert [name for name in missing if "NAME" not in name] == []


def test_glossary_is_in_alphabetical_order() -> None:
    """A reader finds a word by its place."""
    lines = (DOCS / "glossary.md").read_text(encoding="utf-8").splitlines()
    words = [line.split("|")[1].strip() for line in lines if line.startswith("|")][2:]
    assert words
    assert words == sorted(words, key=str.casefold)
