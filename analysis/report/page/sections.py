"""What the page shows of outputs that are installed: sections of their own, as JSON."""

import base64
import json
from collections.abc import Iterable
from typing import Any

from analysis.report.outputs import Say, left_out
from analysis.report.page.of_run import table_contents
from tacevo.parts.output import Section
from tacevo.parts.registry import Part


def sections_contents(sections: Iterable[tuple[Part, Section]], say: Say) -> list[dict[str, Any]]:
    """Return sections with their figures drawn, each with who it comes from.

    A figure that raises is left out, or a section, of which more does; `say` is called with a sentence on each.
    """
    shown: list[dict[str, Any]] = []
    for part, section in sections:
        with left_out(part, "section", say):
            contents = {
                "title": section.title,
                "by": f"{part.name}, {part.origin}",
                "sentences": list(section.sentences),
                "figures": _drawn(part, section, say),
                "tables": [table_contents(table) for table in section.tables],
            }
            json.dumps(contents)  # what is no text raises here, and not where the whole page is written
            shown.append(contents)
    return shown


def _drawn(part: Part, section: Section, say: Say) -> list[dict[str, str]]:
    """Draw the figures of a section as `data:` addresses."""
    drawn = []
    for picture in section.figures:
        with left_out(part, f"figure {getattr(picture, 'name', picture)!r} of its section", say):
            from analysis.figures.style import render  # Matplotlib takes a second to import

            image = base64.b64encode(render(picture.draw(), ".png")).decode("ascii")
            drawn.append({"caption": str(picture.caption), "image": f"data:image/png;base64,{image}"})
    return drawn
