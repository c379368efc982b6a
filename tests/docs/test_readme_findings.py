"""Figures of README's findings are those of the published tables, which `make replay` computes anew."""

import re
import zipfile
from fnmatch import fnmatch

import pytest
from checkout import PUBLISHED, ROOT

#: The finding; the bundle; its table; how the row begins; and figures of that row, as README writes them.
FIGURES = [
    (1, "grating-claude", "noise_*", "variant 1", ("0.0705", "0.544")),
    (1, "grating-claude", "noise_*", "baseline", ("0.911",)),
    (2, "grating-claude", "verdicts_*epochs6-*", "variant 1", ("87.4",)),
    (2, "grating-claude", "verdicts_*epochs6-*", "variant 3", ("96.1",)),
    (2, "grating-claude", "verdicts_*epochs6-*", "baseline", ("57.0",)),
    (3, "grating-winners", "verdicts_*", "baseline", ("99.1",)),
    (3, "grating-winners", "verdicts_*", "claude_g12s00", ("99.0",)),
    (3, "grating-winners", "verdicts_*", "grammar_g15s00", ("98.5",)),
    (4, "ablation-grating", "ablation_qd_score_*", "none", ("4.34",)),
    (4, "ablation-grating", "ablation_qd_score_*", "random_parents_only_baseline", ("3.04",)),
    (4, "ablation-grating", "ablation_qd_score_*", "curiosity_prompts", ("3.86",)),
    (4, "ablation-grating", "ablation_test_accuracy_*", "no_qd", ("0.94",)),
    (5, "grating-variants", "verdicts_*", "baseline", ("89.5",)),
]


def row_of(bundle: str, table: str, start: str) -> str:
    """Read the row of a published table that begins with a name, with hyphens for minus signs."""
    with zipfile.ZipFile(PUBLISHED / f"{bundle}.zip") as opened:
        (name,) = (name for name in opened.namelist() if fnmatch(name, f"tables/{table}.md"))
        lines = opened.read(name).decode().replace("\N{MINUS SIGN}", "-").splitlines()
    (row,) = (line for line in lines if re.match(rf"\| {re.escape(start)} +\|", line))
    return row


def stands(figure: str, text: str) -> bool:
    """Return whether a figure stands in a text, whole: not as a part of a longer number."""
    return re.search(rf"(?<![\d.]){re.escape(figure)}(?!\d)", text) is not None


@pytest.mark.parametrize(("finding", "bundle", "table", "start", "figures"), FIGURES)
def test_readme_says_what_the_tables_say(
    finding: int, bundle: str, table: str, start: str, figures: tuple[str, ...]
) -> None:
    """Each figure stands in its row of README and in its row of the table."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (told,) = (line for line in text.splitlines() if line.startswith(f"| {finding}. "))
    row = row_of(bundle, table, start)
    for figure in figures:
        assert stands(figure, told)
        assert stands(figure, row)
