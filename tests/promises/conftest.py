"""The report page of a shipped run, and a browser that opens it."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from browsing import Opener
from pages import page_of_shipped_run
from playwright.sync_api import Browser, Page, ViewportSize

from analysis.report.page.contents import PageContents
from analysis.report.page.html import as_html

_DESKTOP: ViewportSize = {"width": 1280, "height": 900}


@pytest.fixture(scope="session")
def shipped() -> PageContents:
    """Return what the page of a shipped run shows."""
    return page_of_shipped_run()


@pytest.fixture
def open_page(browser: Browser, tmp_path: Path) -> Iterator[Opener]:
    """Return a function that opens contents as a file, and keeps every error and every request that leaves it."""
    contexts = []

    def open_page(
        contents: PageContents, *, address: str = "", size: ViewportSize = _DESKTOP
    ) -> tuple[Page, list[str]]:
        file = tmp_path / "page.html"
        file.write_text(as_html(contents))
        contexts.append(browser.new_context(viewport=size))
        page, wrong = contexts[-1].new_page(), list[str]()
        page.on("console", lambda message: wrong.append(message.text))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on(
            "request", lambda request: wrong.append(request.url) if request.url.split("#")[0] != file.as_uri() else None
        )
        page.goto(f"{file.as_uri()}{address}")
        return page, wrong

    yield open_page
    for context in contexts:
        context.close()
