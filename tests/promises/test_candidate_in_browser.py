"""Promise: in a browser every candidate opens, with what it is, where it is from, and what became of it."""

from dataclasses import replace

from browsing import Opener
from playwright.sync_api import expect

from analysis.report.page.contents import PageContents
from tacevo.records import Reason, Stage


def test_click_on_an_elite_opens_its_source(shipped: PageContents, open_page: Opener) -> None:
    """The source shown is the candidate's, to the letter; its changes name what was lost and gained."""
    page, wrong = open_page(shipped)
    run = shipped.runs[0]
    wanted = next(one for one in run.candidates if one.changes and one.id in dict(run.generations[-1].elites).values())
    page.locator(f'.elites a[href$="/{wanted.id}"] .cell').click()
    expect(page.locator("#candidate-name")).to_have_text(f"Candidate {wanted.id}")
    assert page.locator("#candidate del, #candidate ins").count() > 0
    page.locator("#source-choice").select_option("")
    lines = page.locator("#candidate pre.source .line-of-code").all_text_contents()
    assert wanted.source is not None
    assert "\n".join(lines) == shipped.sources[wanted.source].text
    assert wrong == []


def test_every_candidate_opens_by_its_address(shipped: PageContents, open_page: Opener) -> None:
    """Rejected ones show the answer; trained ones their losses; an address of none changes nothing."""
    page, wrong = open_page(shipped)
    run = shipped.runs[0]
    for one in run.candidates[:: len(run.candidates) // 12]:
        page.evaluate("id => { location.hash = id }", f"#/{run.name}/{one.id}")
        expect(page.locator("#candidate-name")).to_have_text(f"Candidate {one.id}")
        assert page.locator("#candidate figure").count() == bool(one.validation_losses)
    for address in ("#/nobody/g00s00", "#/%E0%A4%A/x", f"#/{run.name}/g99s99", "#/"):
        page.evaluate("hash => { location.hash = hash }", address)
    expect(page.locator("#candidate-name")).to_have_text("Candidate")
    assert wrong == []


def test_back_button_leaves_the_candidate(shipped: PageContents, open_page: Opener) -> None:
    """And an address without a candidate says so."""
    page, wrong = open_page(shipped)
    page.evaluate("location.hash = '#/force-grammar/g01s06'")
    expect(page.locator("#candidate-name")).to_have_text("Candidate g01s06")
    page.go_back()
    expect(page.locator("#candidate-name")).to_have_text("Candidate")
    page.evaluate("location.hash = '#/force-grammar/g99s99'")
    expect(page.locator("#candidate-body")).to_contain_text("This page has no candidate g99s99")
    assert not wrong


def test_descendants_are_links(shipped: PageContents, open_page: Opener) -> None:
    """All that came of a network can be opened from it, in the order in which they came."""
    run = shipped.runs[0]
    first = run.candidates[1]
    page, _ = open_page(shipped, address=f"#/{run.name}/{first.id}")
    cell = page.locator("#candidate-body dt", has_text="All descendants").locator("xpath=following-sibling::dd[1]")
    family = [first.id]
    for one in run.candidates:
        if not set(family).isdisjoint(one.parents):
            family.append(one.id)
    assert len(family) > 2
    assert cell.locator("a").all_text_contents() == family[1:]


def test_gate_path_names_every_stage(shipped: PageContents, open_page: Opener) -> None:
    """What a trained network passed, each answer that was sent back, and where a rejected one ended."""
    run = shipped.runs[0]
    trained, other, *_ = (one for one in run.candidates if one.stage is None and one.parents)
    lost = next(one for one in run.candidates if one.stage is Stage.probe)
    repaired = replace(other, repairs=((Stage.policy, Reason.forbidden_import),))
    candidates = tuple(repaired if one is other else one for one in run.candidates)
    page, _ = open_page(replace(shipped, runs=(replace(run, candidates=candidates),)))
    whole = "extract: passed → policy: passed → probe: passed → train: passed"
    back = "extract: passed → policy: rejected (forbidden_import), sent back"
    for one, expected in (
        (run.candidates[0], ["policy: passed → probe: passed → train: passed"]),
        (trained, [whole]),
        (repaired, [f"Answer 1. {back}", f"Answer 2. {whole}"]),
        (lost, [f"extract: passed → policy: passed → probe: rejected ({lost.reason})"]),
    ):
        page.evaluate("id => { location.hash = id }", f"#/{run.name}/{one.id}")
        expect(page.locator("#candidate-name")).to_have_text(f"Candidate {one.id}")
        assert page.locator("#candidate-body dl ol li").all_inner_texts() == expected


def test_rejected_answer_says_where_it_is_from(shipped: PageContents, open_page: Opener) -> None:
    """Its file has no hash in the ledger."""
    run = shipped.runs[0]
    one = next(one for one in run.candidates if one.rejected is not None)
    page, _ = open_page(shipped, address=f"#/{run.name}/{one.id}")
    assert page.locator(f'pre[aria-label="rejected answer of {one.id}"]').count() == 1
    assert "`tacevo replay` checks it" in page.locator("#candidate-body").inner_text()


def test_reestimates_stand_beside_the_recorded_fitness(shipped: PageContents, open_page: Opener) -> None:
    """Where a candidate was trained again, its further losses are shown."""
    run = shipped.runs[0]
    again = replace(run.candidates[0], reestimates=(0.25, 0.125))
    page, _ = open_page(
        replace(shipped, runs=(replace(run, candidates=(again, *run.candidates[1:])),)),
        address=f"#/{run.name}/{again.id}",
    )
    assert "0.250, 0.125" in page.locator("#candidate-body dl").inner_text()
