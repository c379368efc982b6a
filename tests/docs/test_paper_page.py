"""Promise: docs/paper.md has a row for each decision of ours, and no text calls one of them the paper's."""

import re

import pytest
from checkout import ROOT

from tacevo.config.schema import keys

PAGE = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
ROWS = {line.split("|")[1].strip(): line for line in PAGE.splitlines() if line.startswith("|")}


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("system prompts", "`task.system`"),
        ("instructions", "`task.instructions`"),
        ("baseline a0", "32, 64 and 128 channels; average pooling to 4 x 4; dropout 0.5"),
        ("full training", "50 epochs; the weights of the best validation epoch"),
        ("which four variants are studied", "by validation fitness"),
        ("the gate", "the paper's 96.0 % and 94.5 % are two quantities"),
        ("split of `data=tacverse`", "60/20/20"),
        ("prompt pool P_g (Algorithm 1, line 3)", "`prompts.pool=N`"),
        ("output activations", "as if it were logits"),
        ("axis of the Efficiency Ratio", "`ablation=linear_eff_ratio`"),
    ],
)
def test_decision_has_its_row(place: str, words: str) -> None:
    """Each row says what the paper leaves open, and what we do."""
    assert words in ROWS[place]


def test_every_setting_that_the_page_names_exists() -> None:
    """A reader can set what the last column offers."""
    named = {
        key for line in ROWS.values() for key in re.findall(r"`((?:\w+\.)+\w+)(?:=[^`]*)?`", line.rpartition("| ")[2])
    }
    assert "prompts.pool" in named
    assert named - set(keys()) == set()


def test_no_text_names_a_section_of_the_paper() -> None:
    """Sections of another document were once named as the paper's; Algorithm 1 and its tables are named instead."""
    files = [path for folder in ("tacevo", "analysis", "docs") for path in (ROOT / folder).rglob("*.*")]
    texts = {path: path.read_text(encoding="utf-8") for path in files if path.suffix in {".py", ".md"}}
    section = re.compile(r"paper(\.md)?,? \(?section|its section [IV]+")
    assert [str(path) for path, text in texts.items() if section.search(text)] == []


def test_what_is_ours_is_not_called_the_papers() -> None:
    """The paper states no number of full epochs, no optimiser, and no widths of its baseline."""
    assert "paper trains fully" not in " ".join((ROOT / "docs" / "data.md").read_text(encoding="utf-8").split())
    assert "of our choice" in (ROOT / "conf" / "library" / "force" / "baseline.py").read_text(encoding="utf-8")
    assert "our choice" in (ROOT / "conf" / "training" / "paper.yaml").read_text(encoding="utf-8")
    baselines = [path.read_text(encoding="utf-8") for path in (ROOT / "conf" / "library").glob("*/baseline.py")]
    assert [text for text in baselines if "The paper's baseline" in text] == []


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("abusadeh_tacevo", "via {LLM}-Driven Quality-Diversity Search"),
        ("abusadeh_tacevo", "AbuSadeh, Mohammed and Wei, Lan and Zhang, Dandan"),
        ("tacevo_supplement", "https://github.com/LannWei/TacEvo"),
    ],
)
def test_paper_and_supplement_are_cited_whole(entry: str, words: str) -> None:
    """Title and authors stand in full."""
    entries = (ROOT / "docs" / "references.bib").read_text(encoding="utf-8").split("\n@")
    (text,) = (text for text in entries if f"{{{entry}," in text)
    assert words in text
