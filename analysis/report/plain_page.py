"""A report that is one file: a page of HTML with every table and picture of a run inside it."""

import base64
import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from analysis.figures.style import render
from analysis.report.figure_list import Picture
from analysis.rounding import shown
from analysis.runs.run import Run
from analysis.table import Table
from analysis.tables.rendering import numeric_columns

#: Letters of 7 points are for paper.
_ZOOM = 1.5

_PAGE = """\
<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>{title}</title>
<style>
body {{ font: 15px/1.45 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #111; }}
table {{ border-collapse: collapse; margin: 0.4em 0; font-size: 13px; }}
th, td {{ padding: 0.15em 0.7em; border-bottom: 1px solid #ddd; text-align: left; }}
th {{ border-bottom: 2px solid #111; }}
.number {{ text-align: right; font-variant-numeric: tabular-nums; }}
section {{ overflow-x: auto; }}
figure {{ margin: 1.5em 0; }}
img {{ max-width: 100%; }}
h2, figcaption {{ font-size: 15px; font-weight: bold; margin: 1.6em 0 0.3em; }}
.note {{ font-size: 13px; margin: 0.2em 0; }}
</style>
</head>
<body>
<h1>{title}</h1>
{body}
</body>
</html>
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Image:
    """A picture that is drawn."""

    caption: str
    #: In inches.
    width: float
    png: bytes


def drawn(picture: Picture, on_drawn: Callable[[str], object]) -> Image:
    """Draw a picture for a report, and report its name."""
    figure = picture.draw()
    image = Image(caption=picture.caption, width=float(figure.get_figwidth()), png=render(figure, ".png"))
    on_drawn(picture.name)
    return image


def as_html(run: Run, tables: Sequence[Table], images: Sequence[Image], remarks: Sequence[str]) -> str:
    """Write the report of a run.

    Args:
        run: the run.
        tables: rounded by the rule of `analysis.rounding`.
        images: its figures.
        remarks: sentences above all, e.g. what is missing.
    """
    parts = [
        f"<p>{html.escape(_origin(run))}</p>",
        f"<p>{len(run.candidates)} candidates in {len(run.generations)} generations; digest "
        f"<code>{run.digest}</code>.</p>",
        *(f"<p>{html.escape(remark)}</p>" for remark in remarks),
        *map(_figure, images),
        *map(_table, tables),
    ]
    return _PAGE.format(title=html.escape(run.name), body="\n".join(parts))


def _origin(run: Run) -> str:
    """Name the task, the model and the source of the images."""
    model, source = run.config.llm, run.config.data.source
    return f"Task: {run.task}. Model: {model.model}, provider: {model.provider}. Data source: {source}."


def _figure(image: Image) -> str:
    data = base64.b64encode(image.png).decode("ascii")
    words = html.escape(image.caption)
    shape = f'style="width: {image.width * _ZOOM:.2f}in" src="data:image/png;base64,{data}"'
    return f'<figure>\n<figcaption>{words}</figcaption>\n<img alt="{words}" {shape}>\n</figure>'


def _table(table: Table) -> str:
    numeric = numeric_columns(table)
    head = _row("th", table.columns, numeric)
    rows = [_row("td", [shown(cell) for cell in row], numeric) for row in table.rows]
    notes = [f'<p class="note">{html.escape(note)}</p>' for note in table.notes]
    body = "\n".join(["<table>", head, *rows, "</table>", *notes])
    return f"<section>\n<h2>{html.escape(table.caption)}</h2>\n{body}\n</section>"


def _row(tag: str, texts: Sequence[str], numeric: Sequence[bool]) -> str:
    pairs = zip(texts, numeric, strict=True)
    cells = [f"<{tag}{' class=number' if number else ''}>{html.escape(text)}</{tag}>" for text, number in pairs]
    return f"<tr>{''.join(cells)}</tr>"
