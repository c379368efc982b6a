"""Draw every figure of published runs for the page of the gallery, below the command that writes it."""

import re
from pathlib import Path

import matplotlib.pyplot as plt

import tacevo

#: Where the published runs lie, from the root of the checkout.
PUBLISHED = "cache/published"

#: The headings of the gallery, with the command that draws what stands below, and how many pixels an inch has.
RUN = ("A search", f"tacevo figures {PUBLISHED}/grating-claude.zip -o figures")
SWEEP = ("Arms of an ablation", f"tacevo ablations {PUBLISHED}/ablation-proposals.zip -o arms")
DPI = 110


def meanings(page: Path) -> dict[str, str]:
    """Read what each figure shows, by name, from the tables of a page."""
    rows = re.findall(r"^\| `(\w+)` \| (.+?) \|", page.read_text(encoding="utf-8"), re.MULTILINE)
    return dict(rows)


def write(root: Path, folder: Path) -> str:
    """Draw every figure into a folder; return what the page shows below its introduction."""
    folder.mkdir(parents=True, exist_ok=True)
    shows = meanings(root / "docs/figures.md")
    run = tacevo.open(root / PUBLISHED / "grating-claude.zip")
    sweep = tacevo.open(root / PUBLISHED / "ablation-proposals.zip")
    of_run = {name: draw for name, draw in run.figures.items() if name in shows}  # and not those of each study again
    parts = []
    for (heading, command), drawn in ((RUN, of_run), (SWEEP, dict(sweep.figures))):
        parts += [f"## {heading}", f"```sh\n{command}\n```"]
        for name, draw in drawn.items():
            picture = f"{name}.png"
            draw().savefig(folder / picture, dpi=DPI, bbox_inches="tight")
            plt.close("all")
            shown = shows.get(name, "")
            parts += [f"### {name}", *([f"{shown[0].upper()}{shown[1:]}."] if shown else [])]
            parts += [f"![{name}]({folder.name}/{picture})"]
    return "\n\n".join(parts) + "\n"
