"""How a test opens a report page in a browser."""

from collections.abc import Callable

from playwright.sync_api import Page, ViewportSize

#: What the fixture `open_page` takes, and what it found wrong until now: errors, and requests that left the page.
Opener = Callable[..., tuple[Page, list[str]]]

DESKTOP: ViewportSize = {"width": 1280, "height": 900}
