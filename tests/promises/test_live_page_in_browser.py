"""Promise: in a real browser the page of `tacevo watch` follows a running search, and says so when nobody answers."""

import threading
import zipfile
from pathlib import Path

import pytest
from pages import SHIPPED
from playwright.sync_api import Browser, expect

from tacevo.bundles.open import opened
from tacevo.cli.watch import LivePage, Server


def unzipped(folder: Path) -> Path:
    """Unpack the run of the bundle into a directory of its own."""
    with zipfile.ZipFile(SHIPPED) as archive:
        archive.extractall(folder, [name for name in archive.namelist() if name.startswith("run/")])
    return folder / "run"


@pytest.mark.slow
def test_live_page_redraws_and_outlives_its_server(browser: Browser, tmp_path: Path) -> None:
    """The page shows what was added to the run without a reload, keeps the choice, and says that nobody answers."""
    run = unzipped(tmp_path)
    place = opened(SHIPPED)
    store = place.store
    whole = (run / "ledger.jsonl").read_text().splitlines(keepends=True)
    ends = [number for number, line in enumerate(whole, start=1) if '"kind":"generation"' in line]
    (run / "ledger.jsonl").write_text("".join(whole[: ends[3]]))
    page = browser.new_page()
    with Server(LivePage(run, store), 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        page.goto(f"{server.address}#/run/g01s06")
        page.wait_for_selector(".elites a")
        assert page.get_attribute("#generation", "max") == "3"
        numbers = page.locator("#dynamics-figures details").first
        numbers.locator("summary").click()
        page.locator("#source-choice").select_option("")
        link = page.locator("#lineage-tree a[tabindex='0']")
        link.focus()
        focused = page.evaluate("document.activeElement.href.baseVal")
        (run / "ledger.jsonl").write_text("".join(whole))
        expect(page.locator("#generation")).to_have_attribute("max", "20", timeout=60_000)
        assert page.locator("#candidate-name").inner_text() == "Candidate g01s06"
        assert page.locator("#state").inner_text().startswith("1 of 1 run finished")
        assert numbers.get_attribute("open") is not None
        assert page.locator("#source-choice").input_value() == ""
        assert page.evaluate("document.activeElement.href.baseVal") == focused
        server.shutdown()
        thread.join()
    expect(page.locator("#state")).to_contain_text("No answer from")
    with Server(LivePage(run, store), server.server_port) as other:
        thread = threading.Thread(target=other.serve_forever)
        thread.start()
        expect(page.locator("#state")).to_contain_text("started again under another address", timeout=60_000)
        other.shutdown()
        thread.join()
    page.close()


@pytest.mark.slow
def test_address_is_followed_once_the_search_has_begun(browser: Browser, tmp_path: Path) -> None:
    """Before, there is no run to choose from."""
    page = browser.new_page()
    place = opened(SHIPPED)
    with Server(LivePage(tmp_path / "run", place.store), 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        page.goto(f"{server.address}#/run/g01s06")
        assert not page.locator("#run-label").is_visible()
        unzipped(tmp_path)
        expect(page.locator("#candidate-name")).to_have_text("Candidate g01s06", timeout=60_000)
        server.shutdown()
        thread.join()
    page.close()
