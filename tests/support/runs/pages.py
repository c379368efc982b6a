"""Contents of the report page for tests: those of a shipped run, and the same with hostile texts in every place."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from checkout import BUNDLES
from playwright.sync_api import Page

from analysis.report.collection import collect, tables_of
from analysis.report.page.of_run import RunMaterial, read_texts
from analysis.report.page.source_texts import marked
from analysis.report.page.whole import PageContents, page_contents
from tacevo.bundles.open import opened
from tacevo.evolution.archive import AddStatus
from tacevo.records import Operator, Reason, Stage

#: What would do harm as markup, and what could end the element that holds the contents; `hurt` is set if it runs.
HOSTILE = (
    " </script><script>window.hurt = 1</script><img src=x onerror='window.hurt = 2'><!--<script>]]>"
    "\u2028\u2029{{ 7 * 7 }}\"'><svg onload='window.hurt = 3'>\x00\u202e&lt;b&gt; javascript:window.hurt=4"
)

#: What a ledger names things by, and no text from outside: the script looks for these.
_WORDS = {*Operator, *Stage, *Reason, *AddStatus}

#: Mappings whose keys come from outside, too.
_NAMED = {"sources", "settings", "bands", "ends"}

#: As an installed output adds it; the image is one white pixel.
SECTION = {
    "title": "Ancestors",
    "by": "ancestors, mylab 1.0",
    "sentences": ["Few.", "Many."],
    "figures": [
        {
            "caption": "A pixel.",
            "image": "data:image/png;base64,"
            "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGP4DwABAQEAsTjW7AAAAABJRU5ErkJggg==",
        }
    ],
    "tables": [
        {"caption": "Of jobs.", "columns": ["job"], "numeric": [False], "rows": [["a"], ["b"]], "notes": ["Two."]}
    ],
}

#: One of the first published runs (test_rules).
SHIPPED = BUNDLES / "force-grammar.zip"


def page_of_shipped_run() -> PageContents:
    """Return what the page of a shipped run with a study shows, without its sample images."""
    place = opened(SHIPPED)
    return page_of(place.folder, place.store, title="force-grammar.zip")


def page_of(run: Path, store: Path, *, title: str) -> PageContents:
    """Return what the page of a run shows, without its sample images."""
    collection = collect(run, store)
    material = RunMaterial(
        collection=collection,
        texts=read_texts(collection.run)[0],
        tables=tables_of(collection, None),
        sections=[SECTION],
    )
    return page_contents([material], title=title, checked=[f"digest {64 * 'f'}"], commands=["tacevo replay it"])


def poisoned(page: PageContents) -> PageContents:
    """Return contents with `HOSTILE` behind every text: ids, names, sources, answers, table cells, keys of mappings."""
    return replace(page, **{field.name: _poisoned(getattr(page, field.name), field.name) for field in fields(page)})


def check_panels(page: Page, contents: PageContents) -> None:
    """Compare how much every panel holds with the records."""
    (run,) = contents.runs
    assert page.locator("#map-drawing .cells path").count() == len(run["cells"])
    assert elites_on_map(page) == elites_of(run["generations"][-1])
    assert page.locator("#candidates-table tbody tr").count() == len(run["candidates"])
    assert page.locator("#lineage-line li").count() > 1
    assert page.locator("#lineage-tree a").count() >= len(run["generations"][-1]["elites"])
    assert page.locator("#dynamics-figures figure").count() >= 7
    assert page.locator("#studies-body circle").count() == sum(
        len(one["values"]) for study in run["studies"] for one in study["networks"]
    )
    assert page.locator("#run-tables details").count() == len(run["tables"])
    assert page.locator("#parts-body section").count() == len(run["sections"])
    for section in run["sections"]:
        for text in (section["title"], *section["sentences"], section["by"]):
            assert page.locator("#parts-body", has_text=" ".join(text.split())).count()
    assert page.locator("#parts-body img").count() == sum(len(section["figures"]) for section in run["sections"])
    assert page.locator("#headlines p").all_text_contents() == list(run["headlines"])
    assert page.locator("#checked li").all_inner_texts() == list(contents.checked)
    assert run["provenance"][1][1] in page.locator("#provenance-facts").inner_text()


def elites_on_map(page: Page) -> set[str]:
    """Return the elites that the map links to, by id."""
    links = page.eval_on_selector_all(".elites a", "all => all.map(a => a.href.baseVal)")
    return {link.rsplit("/", 1)[1] for link in links}


def elites_of(generation: dict[str, Any]) -> set[str]:
    """Return the elites that the archive had at the end of a generation, by id."""
    return {name for _, name in generation["elites"]}


def _poisoned(value: Any, name: str = "") -> Any:
    """Return JSON with `HOSTILE` behind its texts; those of a mapping of a `name` that is `_NAMED` behind its keys."""
    if isinstance(value, str) and value not in _WORDS and name != "image":  # which the page draws itself
        return value + HOSTILE
    if isinstance(value, dict) and "marks" in value:
        return {"text": value["text"] + HOSTILE, "marks": marked(value["text"] + HOSTILE)}
    if isinstance(value, dict):
        behind = HOSTILE if name in _NAMED else ""
        return {f"{key}{behind}": _poisoned(one, key) for key, one in value.items()}
    return [_poisoned(one) for one in value] if isinstance(value, list | tuple) else value
