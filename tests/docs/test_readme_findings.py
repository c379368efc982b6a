"""Figures in four of README's five sentences are those of the published tables, which `make replay` computes anew."""

import re
import zipfile
from fnmatch import fnmatch

import pytest
from checkout import PUBLISHED, ROOT

#: The sentence; the bundle; its table; how the row begins; and figures of that row, as the sentence writes them.
FIGURES = [
    (1, "grating-claude", "noise_*", "variant 1", ("0.0705", "0.544")),
    (1, "grating-claude", "noise_*", "baseline", ("0.954", "0.911")),
    (1, "grating-claude", "noise_*", "variant 3", ("0.272",)),
    (1, "grating-grammar", "noise_*", "variant 1", ("0.124", "0.528")),
    (1, "grating-grammar", "noise_*", "variant 3", ("0.391",)),
    (1, "grating-grammar", "noise_*", "baseline", ("0.912", "0.911")),
    (2, "grating-claude", "verdicts_*epochs6-*", "variant 1", ("87.4",)),
    (2, "grating-claude", "verdicts_*epochs6-*", "variant 3", ("96.1",)),
    (2, "grating-claude", "verdicts_*epochs6-*", "baseline", ("57.0",)),
    (2, "grating-grammar", "verdicts_*epochs6-*", "variant 1", ("92.8",)),
    (2, "grating-grammar", "verdicts_*epochs6-*", "variant 2", ("83.2",)),
    (2, "grating-winners", "verdicts_*", "baseline", ("99.1",)),
    (2, "grating-winners", "verdicts_*", "claude_g12s00", ("99.0", "0.52")),
    (2, "grating-winners", "verdicts_*", "grammar_g15s00", ("98.5", "0.028")),
    (4, "ablation-grating", "ablation_qd_score_*", "none", ("4.34",)),
    (4, "ablation-grating", "ablation_qd_score_*", "random_parents_only_baseline", ("3.04",)),
    (4, "ablation-grating", "ablation_qd_score_*", "curiosity_prompts", ("3.86",)),
    (4, "ablation-grating", "ablation_test_accuracy_*", "random_parents_only_baseline", ("-0.64 [-5.68, 4.25]",)),
    (4, "ablation-grating", "ablation_test_accuracy_*", "no_qd", ("0.94",)),
    (5, "grating-variants", "verdicts_*", "baseline", ("89.5",)),
    (5, "grating-variants", "verdicts_*", "variant4", ("0.010",)),
    (5, "force-variants", "verdicts_*", "baseline", ("0.00773",)),
    (5, "force-variants", "verdicts_*", "variant4", ("0.0174",)),
    (5, "force-variants", "verdicts_*", "variant2", ("0.0230",)),
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


@pytest.mark.parametrize(("sentence", "bundle", "table", "start", "figures"), FIGURES)
def test_readme_says_what_the_tables_say(
    sentence: int, bundle: str, table: str, start: str, figures: tuple[str, ...]
) -> None:
    """Each figure stands in its sentence and in its row."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    told = text[text.index(f"\n{sentence}. ") :].split(f"\n{sentence + 1}. ")[0].split("\n\n")[0]
    row = row_of(bundle, table, start)
    for figure in figures:
        assert stands(figure, told)
        assert stands(figure, row)
