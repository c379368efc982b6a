"""Promise: a published run says plainly what answered, where its images come from, and under which terms it stands."""

from dataclasses import replace

import pytest
from fakes import TASK
from hand_runs import configured, of_lines
from ledger_lines import FACTS, candidate, run_record
from refusals import refused
from rendered import HOSTILE, skeleton

from tacevo.bundles.readme import Subject, Terms, citation, licence, readme
from tacevo.errors import ConfigError


def subject(*, provider: str, source: str) -> Subject:
    """Make a run of a provider and a source of images, with 86 candidates."""
    config = configured(
        seed=3,
        llm={"provider": provider, "model": "model-1"},
        data={"source": source, "root": "ViTacTip", "images": 600, "image_size": 32, "spacings_mm": [0.5, 1.0]},
    )
    record = run_record(
        name="one",
        task=replace(TASK, name="force"),
        data=replace(FACTS, counts=(480, 60, 60), fingerprint="f" * 64),
        versions={"tacevo": "0.1.0", "python": "3.11", "torch": "2.13", "numpy": "2.4"},
        machine={"cpu": "a CPU", "architecture": "x86_64", "system": "Linux", "libc": "glibc"},
    )
    run = of_lines(candidate("g00s00"), *(candidate("g00s01"),) * 85, config=config, record=record)
    return Subject(runs=(run,), studies=({"s": "e" * 64, "t": "f" * 64},))


def test_page_says_what_answered_and_where_the_images_come_from() -> None:
    """The label stands in the description, which every page repeats; images with a command or a fingerprint."""
    drawn, asked = subject(provider="grammar", source="simulated"), subject(provider="anthropic", source="csv")
    assert "Answers by the grammar provider: no LLM." in drawn.description
    assert "Images of a simulated sensor, not of a real one." in drawn.description
    assert "86 candidates, 2 studies." in drawn.description
    assert "Answers by the language model model-1 (llm=anthropic)." in asked.description
    assert "no LLM" not in asked.description
    assert (
        "tacevo data simulate task=force data.images=600 data.image_size=32 data.seed=0 data.sensor_seed=0 "
        "data.light=standard 'data.spacings_mm=[0.5,1.0]' out=DIR" in readme(drawn, has_lock=True)
    )
    data = replace(drawn.first.config.data, gel_mm=1.5)
    gelled = replace(drawn, runs=(replace(drawn.first, config=replace(drawn.first.config, data=data)),))
    assert "data.gel_mm=1.5 out=DIR" in readme(gelled, has_lock=True)
    text = readme(asked, has_lock=False).replace("\n", " ")
    for words in (
        "They are not part of this bundle",
        "`ViTacTip` (data.root)",
        f"Fingerprint {'f' * 64}",
        "No lock file of these versions was at hand.",
    ):
        assert words in text


@pytest.mark.parametrize("source", ["simulated", "csv", "table"])
@pytest.mark.parametrize("text", HOSTILE)
def test_text_of_a_stranger_is_text_in_the_page(text: str, source: str) -> None:
    """Of a note, names, versions, a machine and a place of images."""

    def said(words: str) -> str:
        whole = subject(provider="anthropic", source=source)
        run, data = whole.first, replace(whole.first.config.data, root=words)
        record = replace(
            run.record,
            name=words,
            task=replace(run.record.task, name=words),
            versions={**run.record.versions, "torch": words},
            machine={**run.record.machine, "cpu": words},
            data=replace(run.record.data, fingerprint=words),
        )
        told = replace(run, record=record, config=replace(run.config, data=data))
        return readme(replace(whole, runs=(told,), studies=({words: "e" * 64},), note=(words, words)), has_lock=True)

    calm, attacked = said("word"), said(f"x {text} y")
    assert skeleton(attacked) == skeleton(calm)


def test_given_networks_are_not_passed_off_as_found() -> None:
    """Neither title nor description speaks of a search where no model was asked."""
    searched = subject(provider="grammar", source="simulated")
    ledger = replace(searched.first.ledger, lines=searched.first.ledger.lines[:1])
    given = replace(searched, runs=(replace(searched.first, ledger=ledger),))
    for text in (given.title, given.description):
        assert "search" not in text
    assert "No model was asked: the networks were given." in given.description


def test_terms_stand_in_licence_and_citation() -> None:
    """The bundle's and the code's, with strange names as they are."""
    terms = Terms(licence="CC0-1.0", authors=("Zoë: #1", "B"), published="2026-11-21")
    assert licence(terms).startswith("This published run is licensed by Zoë: #1, B under CC0-1.0:\n")
    assert "Apache-2.0" in licence(terms)
    cited = citation(subject(provider="grammar", source="csv"), terms)
    assert "- name: 'Zoë: #1'" in cited
    assert "date-released: 2026-11-21" in cited
    assert "license: CC0-1.0" in cited
    nobody = citation(subject(provider="grammar", source="csv"), replace(terms, authors=()))
    assert "authors:\n- name: anonymous\n" in nobody


@pytest.mark.parametrize("licence_id", ["", "MIT or so", "../x", "<b>", "MIT\n", "Foo", "mit", "LicenseRef-Ours"])
def test_licence_must_be_an_identifier(licence_id: str) -> None:
    """It becomes part of an address."""
    with refused(ConfigError, place="--license", expected="an SPDX identifier"):
        Terms(licence=licence_id, authors=(), published="2026-11-21")
