"""Promise: in a browser the page fills every panel, follows mouse and keyboard, runs no foreign text, asks nobody."""

import io
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pages import HOSTILE, check_panels, elites_of, elites_on_map, page_of, page_of_shipped_run, poisoned
from playwright.sync_api import Browser, Page, ViewportSize, expect
from rich.console import Console

from analysis.report.page.html import as_html
from analysis.report.page.source_texts import source_contents
from analysis.report.page.whole import PageContents
from benchmarks.synthetic import record_synthetic
from tacevo.gate.imports import with_imports
from tacevo.runs.progress import Progress

#: What `open_page` takes, and what it found wrong until now: errors, and requests that left the page.
Opener = Callable[..., tuple[Page, list[str]]]

_DESKTOP: ViewportSize = {"width": 1280, "height": 900}
_PHONE: ViewportSize = {"width": 390, "height": 844}

#: A4 less its margins, at 96 dots an inch.
_SHEET: ViewportSize = {"width": 718, "height": 1047}


@pytest.fixture(scope="module")
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


def address_of(run: dict[str, Any], candidate: str) -> str:
    """Return the address of a candidate within the page."""
    return f"#/{run['name']}/{candidate}"


def test_every_panel_is_filled_and_nothing_is_asked(shipped: PageContents, open_page: Opener) -> None:
    """No error, no request; map, lineage, table, figures, study, tables and provenance hold what the records have."""
    page, wrong = open_page(shipped)
    check_panels(page, shipped)
    assert wrong == []


@pytest.mark.parametrize("size", [{"width": 1400, "height": 900}, {"width": 400, "height": 844}])
def test_first_screen_says_what_was_found_and_shows_the_map(
    shipped: PageContents, open_page: Opener, size: ViewportSize
) -> None:
    """The finding is the first sentence, the facts are folded away, and half of the map is in sight at least."""
    page, wrong = open_page(shipped, size=size)
    (run,) = shipped.runs
    assert page.locator("#found li").all_inner_texts() == run["found"] != []
    assert not page.locator("#headlines").is_visible()
    drawn = page.locator("#map-drawing svg").bounding_box()
    assert drawn is not None
    assert drawn["y"] + drawn["height"] / 2 < size["height"]
    page.locator("#facts summary").click()
    assert page.locator("#headlines").is_visible()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert wrong == []


def test_chart_of_fitness_has_baseline_and_reestimates(shipped: PageContents, open_page: Opener) -> None:
    """Nobody can cut the record out of the page without what corrects it."""
    (run,) = shipped.runs
    again = {one["id"]: 2 * one["fitness"] for one in run["candidates"][:3] if one["fitness"] is not None}
    page, _ = open_page(replace(shipped, runs=({**run, "again": again},)))
    chart = page.locator("#dynamics-figures figure").first
    assert chart.locator(".level").count() == 2  # the line and its mark in the legend
    assert chart.locator("svg:not(.mark) > .estimate").count() == len(again) > 1
    assert chart.locator("svg:not(.mark) > .estimate text").all_text_contents() == list(again)
    assert "re-estimated" in str(chart.locator("svg").first.get_attribute("aria-label"))
    assert "rejected at" in page.locator("#dynamics-figures").inner_text()


def test_map_says_what_its_marks_and_ends_mean(shipped: PageContents, open_page: Opener) -> None:
    """Each kind of mark and edge is in the legend; axes say what lies at their ends, and every point is whole."""
    (run,) = shipped.runs
    page, wrong = open_page(shipped)
    assert page.locator("#map-legend li").count() >= 4
    names = page.locator("#map-drawing .axes").text_content() or ""
    assert all(words in names for ends in run["directions"] for words in ends)
    assert page.locator(".points path").count() == len(run["generations"][-1]["elites"])
    frame = page.locator("#map-drawing rect.empty").bounding_box()
    assert frame is not None
    for point in page.locator(".points path:not(.is-best)").all():
        box = point.bounding_box()
        assert box is not None
        assert frame["x"] <= box["x"] <= box["x"] + box["width"] <= frame["x"] + frame["width"]
        assert frame["y"] <= box["y"] <= box["y"] + box["height"] <= frame["y"] + frame["height"]
    own, _ = open_page(replace(shipped, runs=({**run, "directions": [None, None]},)))  # a user's own descriptors
    assert "\N{LEFTWARDS ARROW}" not in (own.locator("#map-drawing .axes").text_content() or "")
    assert wrong == []


def test_best_on_record_that_is_not_on_the_front_is_named(shipped: PageContents, open_page: Opener) -> None:
    """Trained again, it may have lost its place to networks that were not; both are said."""
    (run,) = shipped.runs
    page, _ = open_page(shipped)
    best = page.locator("#candidate-name").inner_text().removeprefix("Candidate ")
    others = [name for _, name in run["generations"][-1]["elites"] if name != best][:2]
    without = {"again": {best: 9.5}, "front": others}
    page, _ = open_page(replace(shipped, runs=({**run, "pareto": without},)))
    told = page.locator("#pareto-figures").inner_text()
    assert f"{best}, best on record" in told
    assert "9.50" in told


@pytest.mark.parametrize(
    ("settings", "dropped", "told"),
    [
        ({"llm": {"provider": "grammar"}}, [], "mutation strength"),
        ({"temperature": {"carrier": "none"}}, [], "sent to no model"),
        ({"temperature": {"carrier": "words"}}, [], "one of several sentences"),
        ({}, ["temperature"], "not sent"),
        ({}, [], "the makers said this"),
    ],
)
def test_page_says_what_a_temperature_is(
    shipped: PageContents, open_page: Opener, settings: dict[str, Any], dropped: list[str], told: str
) -> None:
    """By what carried it; where it was not sent, or its makers noted something, that stands there."""
    (run,) = shipped.runs
    changed = {
        "settings": {**run["settings"], "llm": {"provider": "anthropic"}, **settings},
        "candidates": [{**one, "dropped": dropped} for one in run["candidates"]],
        "on_temperature": ["Of temperatures the makers said this."] if "makers" in told else [],
    }
    page, wrong = open_page(replace(shipped, runs=({**run, **changed},)))
    caption = page.locator("figcaption", has_text=re.compile("^Temperature"))
    figure = page.locator("#dynamics figure").filter(has=caption)
    assert told in figure.inner_text()
    assert page.locator("#candidate a[href='#temperature-note']").count() == ("makers" in told)
    assert wrong == []


def test_page_has_no_texts_of_what_a_run_lacks(shipped: PageContents, open_page: Opener) -> None:
    """Without rejections, skipped candidates or re-estimates none of these is spoken of."""
    (run,) = shipped.runs
    lines = [{**line, "rejected": dict.fromkeys(line["rejected"], 0), "skipped": None} for line in run["generations"]]
    page, wrong = open_page(replace(shipped, runs=({**run, "generations": lines, "again": {}},)))
    told = page.locator("#dynamics").inner_text()
    assert "none was rejected" in told
    assert "none was rejected" not in page.locator("#dynamics-figures").inner_text()  # which has no empty field for it
    assert not [word for word in ("rejected at", "skipped", "surrogate", "re-estimated") if word in told]
    assert wrong == []


@pytest.mark.slow
def test_thousand_candidates_have_a_page(tmp_path: Path, open_page: Opener) -> None:
    """It is below 15 MB, every panel is filled, and the slider goes to any generation."""
    record_synthetic(tmp_path, 20, Progress(Console(file=io.StringIO())))
    contents = page_of(tmp_path / "run", tmp_path / "cache", title="synthetic")
    (run,) = contents.runs
    assert len(run["candidates"]) > 1_000
    assert len(as_html(contents)) < 15_000_000
    page, wrong = open_page(contents)
    check_panels(page, contents)
    for line in (run["generations"][0], run["generations"][10], run["generations"][20]):
        page.locator("#generation").fill(str(line["generation"]))
        assert elites_on_map(page) == elites_of(line)
    assert wrong == []


@pytest.mark.slow
def test_page_opens_with_the_best_network(shipped: PageContents, open_page: Opener) -> None:
    """Its panel, and its mark on the map; another one is chosen by its address, and going back leads to the best."""
    page, wrong = open_page(shipped)
    run = shipped.runs[0]
    losses = {one["id"]: one["fitness"] for one in run["candidates"]}
    best = min(elites_of(run["generations"][-1]), key=lambda name: losses[name])
    expect(page.locator("#candidate-name")).to_have_text(f"Candidate {best}")
    assert page.locator(f'.elites a.is-selected[href$="/{best}"]').count() == 1
    page.evaluate("hash => { location.hash = hash }", address_of(run, "g00s00"))
    expect(page.locator("#candidate-name")).to_have_text("Candidate g00s00")
    page.go_back()
    expect(page.locator("#candidate-name")).to_have_text(f"Candidate {best}")
    assert wrong == []


@pytest.mark.slow
def test_click_on_an_elite_opens_its_source(shipped: PageContents, open_page: Opener) -> None:
    """The source shown is the candidate's, to the letter; its changes name what was lost and gained."""
    page, wrong = open_page(shipped)
    run = shipped.runs[0]
    elites = elites_of(run["generations"][-1])
    wanted = next(one for one in run["candidates"] if one["changes"] and one["id"] in elites)
    name = wanted["id"]
    page.locator(f'.elites a[href$="/{name}"] .cell').click()
    expect(page.locator("#candidate-name")).to_have_text(f"Candidate {name}")
    assert page.locator("#candidate del, #candidate ins").count() > 0
    page.locator("#source-choice").select_option("")
    lines = page.locator("#candidate pre.source .line-of-code").all_text_contents()
    assert "\n".join(lines) == shipped.sources[wanted["source"]]["text"]
    assert wrong == []


@pytest.mark.slow
def test_copied_source_is_a_file_that_runs(shipped: PageContents, open_page: Opener) -> None:
    """Also where letters of two units stand before its imports; a browser without a clipboard says so."""
    run = shipped.runs[0]
    one = next(one for one in run["candidates"] if one["source"] in shipped.sources and not one["changes"])
    code = shipped.sources[one["source"]]["text"]
    for text in (code, '"""A network. \N{WAVING HAND SIGN}\N{WAVING HAND SIGN}"""\nclass Net(nn.Module):\n    pass\n'):
        contents = replace(shipped, sources={**shipped.sources, one["source"]: source_contents(text)})
        page, wrong = open_page(contents, address=address_of(run, one["id"]))
        page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        page.locator("#source-copy").click()
        expect(page.locator("#source-copy")).to_have_text("Copied")
        copied = page.evaluate("navigator.clipboard.readText()")
        assert copied == with_imports(text)
        exec(compile(copied, "copied.py", "exec"), {"__name__": "copied"})
        assert wrong == []
    page.evaluate("Object.defineProperty(navigator, 'clipboard', {value: undefined})")
    page.locator("#source-copy").click()
    expect(page.locator("#source-copy")).to_contain_text(f"tacevo show RUN {one['id']} --source")


@pytest.mark.slow
def test_every_candidate_opens_by_its_address(shipped: PageContents, open_page: Opener) -> None:
    """Trained ones show their losses, rejected ones the answer, which no hash in the ledger vouches for.

    An address of none changes nothing, or says so; the back button leaves a candidate.
    """
    page, wrong = open_page(shipped)
    run, name = shipped.runs[0], page.locator("#candidate-name")
    rejected = next(one for one in run["candidates"] if one["rejected"] is not None)
    for one in (*run["candidates"][:: len(run["candidates"]) // 12], rejected):
        page.evaluate("id => { location.hash = id }", address_of(run, one["id"]))
        expect(name).to_have_text(f"Candidate {one['id']}")
        assert page.locator("#candidate figure").count() == bool(one["validation_losses"])
    assert page.locator("pre[aria-label^='rejected answer of ']").count() == 1
    assert "tacevo replay checks it" in page.locator("#candidate-body").inner_text()
    for address in ("#/nobody/g00s00", "#/%E0%A4%A/x", "#/", address_of(run, "g99s99")):
        page.evaluate("hash => { location.hash = hash }", address)
    expect(name).to_have_text("Candidate")
    expect(page.locator("#candidate-body")).to_contain_text("This page has no candidate g99s99")
    for _ in range(4):
        page.go_back()
    expect(name).to_have_text(f"Candidate {rejected['id']}")
    assert wrong == []


@pytest.mark.slow
def test_slider_shows_the_archive_of_each_generation(shipped: PageContents, open_page: Opener) -> None:
    """By keyboard, from the first one on: the elites are those of the records, and lost niches are marked."""
    page, wrong = open_page(shipped)
    generations = shipped.runs[0]["generations"]
    page.locator("#generation").focus()
    page.keyboard.press("Home")
    for line, before in zip(generations, (None, *generations), strict=False):
        assert elites_on_map(page) == elites_of(line)
        lost = set() if before is None else dict(before["elites"]).keys() - dict(line["elites"]).keys()
        assert page.locator(".lost path").count() == len(lost)
        page.keyboard.press("ArrowRight")
    assert wrong == []


@pytest.mark.slow
def test_colours_follow_the_choice(shipped: PageContents, open_page: Opener) -> None:
    """Each choice paints the cells in another way, and names its scale."""
    page, _ = open_page(shipped)
    seen = set()
    for choice in ("fitness", "generation", "parameters", "flops"):
        page.locator("#colour").select_option(choice)
        seen.add(str(page.eval_on_selector_all(".elites .cell", "all => all.map(one => one.getAttribute('fill'))")))
    assert len(seen) == 4


@pytest.mark.slow
def test_table_filters_and_sorts(shipped: PageContents, open_page: Opener) -> None:
    """A filter leaves those of its value, and arrow keys walk them; a second click on a column turns the order.

    Absent values stay last.
    """
    page, _ = open_page(shipped)
    candidates = shipped.runs[0]["candidates"]
    page.locator("#filter-outcome").select_option("rejected at probe")
    rows = page.locator("#candidates-table tbody tr:visible a").all_inner_texts()
    assert len(rows) == sum(one["stage"] == "probe" for one in candidates) > 1
    page.locator("#candidates-table tbody tr:visible a").first.focus()
    for row in rows:
        assert page.evaluate("document.activeElement.textContent") == row
        page.keyboard.press("ArrowDown")
    page.locator("#filter-outcome").select_option("")
    page.get_by_role("button", name="loss", exact=True).click()
    best = min((one for one in candidates if one["fitness"] is not None), key=lambda one: one["fitness"])
    assert page.locator("#candidates-table tbody tr").first.locator("a").inner_text() == best["id"]
    page.get_by_role("button", name="loss", exact=True).click()
    worst = max((one for one in candidates if one["fitness"] is not None), key=lambda one: one["fitness"])
    assert page.locator("#candidates-table tbody tr").first.locator("a").inner_text() == worst["id"]
    assert page.locator('th[aria-sort="descending"]').inner_text() == "loss"


@pytest.mark.slow
def test_keyboard_reaches_everything(shipped: PageContents, open_page: Opener) -> None:
    """Tab comes to every control and to one link of map and tree; arrows walk on from there, and Enter opens."""
    page, wrong = open_page(shipped)
    reached: list[str] = []
    name = (
        "(e => e.id || e.closest('#map-drawing, #lineage-tree, #candidates-table tbody')?.closest('[id]').id"
        " || e.getAttribute('aria-label') || e.textContent)"
    )
    order = ["generation", "colour", "map-drawing", "lineage-tree", "filter-outcome", "filter-status", "loss"]
    order += ["candidates-table", "commands", "The settings that decide its results"]
    while order[-1] not in reached and len(reached) < 200:
        page.keyboard.press("Tab")
        reached.append(page.evaluate(f"{name}(document.activeElement)"))
    assert [reached.index(one) for one in order] == sorted(reached.index(one) for one in order)
    assert [reached.count(one) for one in ("map-drawing", "lineage-tree", "candidates-table")] == [1, 1, 1]
    page.locator('.elites a[tabindex="0"]').focus()
    before = page.evaluate("document.activeElement.href.baseVal")
    for key in ("ArrowLeft", "ArrowUp", "ArrowRight"):
        page.keyboard.press(key)
    after = page.evaluate("document.activeElement.href.baseVal")
    assert after != before
    page.keyboard.press("Enter")
    expect(page.locator("#candidate-name")).to_have_text(f"Candidate {after.rsplit('/')[-1]}")
    assert page.evaluate("document.activeElement.id") == "candidate-name"
    assert wrong == []


@pytest.mark.slow
def test_phone_scrolls_in_one_direction(shipped: PageContents, open_page: Opener) -> None:
    """At 390 pixels nothing is wider than the screen; what is wide scrolls in its own box."""
    run = shipped.runs[0]
    page, _ = open_page(shipped, address=address_of(run, run["generations"][-1]["elites"][0][1]), size=_PHONE)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.slow
def test_page_keys_visit_every_elite(shipped: PageContents, open_page: Opener) -> None:
    """Two can be at one point, between which no arrow leads."""
    page, _ = open_page(shipped)
    for box in ("map-drawing", "lineage-tree"):
        links = page.eval_on_selector_all(f"#{box} a", "all => all.map(a => a.href.baseVal)")
        page.locator(f'#{box} a[tabindex="0"]').focus()
        seen = set()
        for _ in links:
            page.keyboard.press("PageDown")
            seen.add(page.evaluate("document.activeElement.href.baseVal"))
        assert seen == set(links)
        page.keyboard.press("PageUp")
        assert page.evaluate("document.activeElement.href.baseVal") in links


@pytest.mark.slow
def test_line_charts_have_their_numbers(shipped: PageContents, open_page: Opener) -> None:
    """What a pointer reads off a line stands in a table that a keyboard reaches."""
    page, _ = open_page(shipped)
    numbers = page.locator("#dynamics-figures figure:has(.readout) details")
    assert numbers.count() == page.locator("#dynamics-figures .readout").count()
    assert numbers.first.locator("tbody tr").count() == len(shipped.runs[0]["generations"])
    assert numbers.first.locator('[role="region"][tabindex="0"][aria-label]').count() == 1


@pytest.mark.slow
def test_elite_that_only_moved_is_not_new(shipped: PageContents, open_page: Opener) -> None:
    """Moved bounds bring old elites into other niches."""
    run = shipped.runs[0]
    before = run["generations"][-1]
    niches = [niche for niche, _ in before["elites"]]
    moved = list(zip(niches[1:] + niches[:1], (name for _, name in before["elites"]), strict=True))
    after = {**before, "generation": before["generation"] + 1, "elites": moved}
    page, _ = open_page(replace(shipped, runs=({**run, "generations": [*run["generations"], after]},)))
    assert ", 0 by a new elite" in page.locator("#generation-words").inner_text()
    assert page.locator(".elites .is-new").count() == 0


@pytest.mark.slow
def test_descendants_are_links(shipped: PageContents, open_page: Opener) -> None:
    """All that came of a network can be opened from it, in the order in which they came.

    Where it was trained again, its further losses are shown.
    """
    run = shipped.runs[0]
    first = {**run["candidates"][1], "again": [0.25, 0.125]}
    candidates = [run["candidates"][0], first, *run["candidates"][2:]]
    page, _ = open_page(
        replace(shipped, runs=({**run, "candidates": candidates},)), address=address_of(run, first["id"])
    )
    assert "0.250, 0.125" in page.locator("#candidate-body dl").inner_text()
    cell = page.locator("#candidate-body dt", has_text="All descendants").locator("xpath=following-sibling::dd[1]")
    family = [first["id"]]
    for one in run["candidates"]:
        if not set(family).isdisjoint(one["parents"]):
            family.append(one["id"])
    assert len(family) > 2
    assert cell.locator("a").all_text_contents() == family[1:]


@pytest.mark.slow
def test_gate_path_names_every_stage(shipped: PageContents, open_page: Opener) -> None:
    """What a trained or skipped network passed, each answer that was sent back, and where a rejected one ended."""
    run = shipped.runs[0]
    trained, other, *_, last = (one for one in run["candidates"] if one["stage"] is None and one["parents"])
    lost = next(one for one in run["candidates"] if one["stage"] == "probe")
    repaired = {**other, "repairs": [{"stage": "policy", "reason": "forbidden_import"}]}
    unknown = {**last, "skipped": True, "fitness": None, "loss": None, "status": None}
    changed = {other["id"]: repaired, last["id"]: unknown}
    candidates = [changed.get(one["id"], one) for one in run["candidates"]]
    page, _ = open_page(replace(shipped, runs=({**run, "candidates": candidates},)))
    whole = "extract: passed → policy: passed → probe: passed → train: passed"
    back = "extract: passed → policy: rejected (forbidden_import), sent back"
    for one, expected in (
        (run["candidates"][0], ["policy: passed → probe: passed → train: passed"]),
        (trained, [whole]),
        (unknown, ["extract: passed → policy: passed → probe: passed → skipped"]),
        (repaired, [f"Answer 1. {back}", f"Answer 2. {whole}"]),
        (lost, [f"extract: passed → policy: passed → probe: rejected ({lost['reason']})"]),
    ):
        page.evaluate("id => { location.hash = id }", address_of(run, one["id"]))
        expect(page.locator("#candidate-name")).to_have_text(f"Candidate {one['id']}")
        assert page.locator("#candidate-body dl ol li").all_inner_texts() == expected


@pytest.mark.slow
def test_every_edge_of_the_lineage_has_its_instruction(shipped: PageContents, open_page: Opener) -> None:
    """It stands where the edge reaches the child, whether or not the child's line is lit."""
    run = shipped.runs[0]
    page, _ = open_page(shipped)
    links = page.eval_on_selector_all("#lineage-tree a", "all => all.map(a => a.href.baseVal)")
    known = {one["id"]: one for one in run["candidates"]}
    shown = [known[link.rsplit("/", 1)[1]] for link in links]
    asked = [
        "crossover" if one["prompt"] is None else run["instructions"][one["prompt"]]["id"]
        for one in shown
        if one["parents"]
    ]
    assert sorted(page.locator("#lineage-tree .edge-names text:visible").all_text_contents()) == sorted(asked)


@pytest.mark.slow
def test_archive_without_niches_speaks_of_places(shipped: PageContents, open_page: Opener) -> None:
    """It ranks its networks, and has no cells."""
    run = {**shipped.runs[0], "cells": []}
    name = run["generations"][-1]["elites"][0][1]
    page, _ = open_page(replace(shipped, runs=(run,)), address=address_of(run, name))
    for box in ("#candidate-body dl", "#map"):
        assert "niche" not in page.locator(box).inner_text().lower()
    labels = page.eval_on_selector_all(".elites a", "all => all.map(a => a.getAttribute('aria-label'))")
    assert all(", place " in label for label in labels)
    colours = page.eval_on_selector_all(".elites .cell", "all => all.map(one => getComputedStyle(one).fill)")
    assert len(set(colours)) > 1
    other = next(elite for _, elite in run["generations"][-1]["elites"] if elite != name)
    page.locator(f'.elites a[href$="/{other}"]').click(force=True)
    expect(page.locator("#candidate-name")).to_have_text(f"Candidate {other}")


def test_hostile_texts_are_shown_and_never_run(shipped: PageContents, open_page: Opener) -> None:
    """Ids, names, sources, answers, table cells, models: each is text on the page, and no script of theirs ran."""
    page, wrong = open_page(poisoned(shipped))
    for row in (0, 12):
        page.locator("#candidates-table tbody tr a").nth(row).click()
        expect(page.locator("#candidate-name")).not_to_have_text("Candidate")
    page.locator("#source-choice").select_option("")
    assert page.locator("#title").text_content() == f"{shipped.title}{HOSTILE}"
    assert HOSTILE.split("\x00")[0] in (page.locator("pre.source").text_content() or "")
    assert page.evaluate("window.hurt") is None
    assert page.locator("script").count() == 2
    assert page.locator("[onerror], [onload]").count() == 0
    assert wrong == []


def test_policy_stops_what_would_become_markup(shipped: PageContents, open_page: Opener) -> None:
    """Even markup that got into the page runs nothing and sends nothing."""
    page, _ = open_page(shipped)
    refused = page.evaluate(
        """() => new Promise((resolve) => {
        const refused = new Set();
        document.addEventListener("securitypolicyviolation", (event) => {
            refused.add(event.effectiveDirective);
            if (refused.size === 5) resolve([...refused].sort());
        });
        const markup = "<img src='https://example.org/x' onerror='window.hurt = 1'>";
        document.body.insertAdjacentHTML("beforeend", `${markup}<iframe src='https://example.org'></iframe>`);
        const script = document.createElement("script");
        script.textContent = "window.hurt = 2";
        document.body.append(script);
        fetch("https://example.org").catch(() => {});
        setTimeout(() => resolve([...refused].sort()), 20_000);
        })"""
    )
    assert refused == ["connect-src", "frame-src", "img-src", "script-src-attr", "script-src-elem"]
    assert page.evaluate("window.hurt") is None


def test_single_generation_has_a_page(shipped: PageContents, open_page: Opener) -> None:
    """Nothing can slide, and every figure has its one value."""
    run = shipped.runs[0]
    first = [one for one in run["candidates"] if one["generation"] == 0]
    short = {**run, "generations": run["generations"][:1], "candidates": first, "studies": [], "tables": []}
    page, wrong = open_page(replace(shipped, runs=(short,)))
    assert page.locator(".elites a").count() == len(run["generations"][0]["elites"])
    assert not page.locator("#studies").is_visible()
    assert wrong == []


@pytest.mark.slow
def test_print_shows_tables_and_no_controls(shipped: PageContents, open_page: Opener) -> None:
    """On paper nothing can be clicked, what is folded on a screen is open, and no table is wider than the sheet."""
    page, _ = open_page(shipped, size=_SHEET)
    page.emulate_media(media="print")
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    assert not page.locator("#generation").is_visible()
    assert page.locator("details:not([open])").count() == 0
    assert page.evaluate("document.documentElement.scrollWidth") <= _SHEET["width"]
