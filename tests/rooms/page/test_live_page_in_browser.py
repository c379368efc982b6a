"""Promise: in a real browser, from disk, the page of a running search reloads itself, and keeps what was chosen."""

import threading
import zipfile
from pathlib import Path

import pytest
from pages import SHIPPED
from playwright.sync_api import Browser, expect

from analysis.report.following import follow
from tacevo.bundles.open import opened

#: What the page holds is that of a search at work.
IS_LIVE = "JSON.parse(document.getElementById('contents').textContent).live"


@pytest.mark.slow
def test_page_follows_its_search_and_keeps_its_place(browser: Browser, tmp_path: Path) -> None:
    """Generation, candidate, colour, filter and scroll position stay; once the search is finished, it stands still.

    The candidate is not the best of those generations: a page that shows the best goes on to the next one.
    """
    with zipfile.ZipFile(SHIPPED) as archive:
        archive.extractall(tmp_path, [name for name in archive.namelist() if name.startswith("run/")])
    run, file = tmp_path / "run", tmp_path / "page.html"
    whole = (run / "ledger.jsonl").read_text().splitlines(keepends=True)
    ends = [number for number, line in enumerate(whole, start=1) if '"kind":"generation"' in line]
    (run / "ledger.jsonl").write_text("".join(whole[: ends[3]]))
    (store,) = {opened(SHIPPED).store}
    following = threading.Thread(target=follow, args=[run, file, store])
    page = browser.new_page()
    following.start()
    try:
        while not file.exists():
            following.join(0.1)
        page.goto(f"{file.as_uri()}#/run/g01s05")
        expect(page.locator("#generation")).to_have_attribute("max", "3")
        page.locator("#generation").fill("2")
        page.locator("#colour").select_option("flops")
        page.locator("#filter-outcome").select_option("trained")
        page.evaluate("scrollTo(0, 700)")
        (run / "ledger.jsonl").write_text("".join(whole))
        expect(page.locator("#generation")).to_have_attribute("max", "20", timeout=120_000)
    finally:
        (run / "ledger.jsonl").write_text("".join(whole))
        following.join()
    page.wait_for_function(f"!{IS_LIVE}", timeout=60_000)
    assert page.locator("#candidate-name").inner_text() == "Candidate g01s05"
    assert page.locator("#state").inner_text().startswith("1 of 1 run finished")
    chosen = [page.locator(name).input_value() for name in ("#generation", "#colour", "#filter-outcome")]
    assert chosen == ["2", "flops", "trained"]
    assert page.evaluate("scrollY") == 700
    page.evaluate("window.stays = true")
    page.wait_for_timeout(6_000)
    assert page.evaluate("window.stays")
    page.close()
