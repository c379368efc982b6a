"""The runs that come with the project are what their page says, and come again anywhere."""

import re
from pathlib import Path

import pytest
from bundles import members_of
from test_rules import DIGESTS

from tacevo.bundles.open import opened
from tacevo.cli.app import main

PUBLISHED = Path(__file__).parents[2] / "cache" / "published"
BUNDLES = sorted(PUBLISHED.glob("*.zip"))

named = pytest.mark.parametrize("bundle", BUNDLES, ids=lambda path: path.stem)


def digests() -> dict[str, str]:
    """Read the digest of each file from the page."""
    page = (PUBLISHED / "README.md").read_text()
    return dict(re.findall(r"^\| `([\w.-]+\.zip)` \|.*\| `([0-9a-f]{64})` \|$", page, flags=re.MULTILINE))


def test_page_names_every_file_with_its_digest() -> None:
    """What is not on the page is not published; `make replay` and test_rules replay what is."""
    assert set(digests()) == {path.name for path in BUNDLES}
    assert digests().items() >= DIGESTS.items()


@named
def test_published_run_says_that_no_language_model_answered(bundle: Path) -> None:
    """Nobody takes the grammar's answers for those of an LLM."""
    members = members_of(bundle)
    assert "no LLM" in members["README.md"].decode()
    assert "no LLM" in members["ro-crate-metadata.json"].decode()


@pytest.mark.slow
def test_published_training_comes_again_bit_for_bit(capsys: pytest.CaptureFixture[str]) -> None:
    """Of the force run, by portable numerics, on this machine."""
    assert main(["replay", str(PUBLISHED / "force-grammar.zip"), "--retrain", "1"]) == 0
    assert "weights are bit for bit as recorded" in capsys.readouterr().out


@pytest.mark.long
def test_published_run_is_taken_up(place: Path) -> None:
    """Ten generations more stand behind lines that are the published ones, byte for byte."""
    bundle = PUBLISHED / "force-grammar.zip"
    assert main(["continue", str(bundle), "search.generations=30", "run.dir=longer", "tracking=none"]) == 0
    with opened(bundle) as published:
        recorded = (published.folder / "ledger.jsonl").read_bytes()
    continued = (place / "longer" / "ledger.jsonl").read_bytes()
    assert continued.startswith(recorded)
    assert continued.count(b'"kind":"generation"') == 31
