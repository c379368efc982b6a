"""The page as one HTML file: contents as JSON, one script, one style, and a policy that lets nothing else run.

What it promises: a text of a candidate, a model or a name is data to the script, which sets it as text; even if it were
to become markup, the page's Content-Security-Policy runs no script but the one whose hash it names, and sends nothing.
"""

import base64
import hashlib
import json
from functools import cache
from importlib.resources import files

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from analysis.report.page.whole import PageContents
from tacevo.records import to_json

#: The script's parts in order: D3 (https://d3js.org; its licence, d3.LICENSE, stands before it), then the page's own,
#: which share one scope.
SCRIPTS = (
    "d3.min.js",
    *("basics.js", "charts.js", "map.js", "candidate.js", "lineage.js"),
    *("table.js", "dynamics.js", "pareto.js", "studies.js", "main.js"),
)


def as_html(contents: PageContents) -> str:
    """Write the page."""
    library, *own = (_part(name) for name in SCRIPTS)
    script = f'/*\n{_part("d3.LICENSE")}*/\n{library}\n(() => {{\n"use strict";\n{"".join(own)}}})();\n'
    style = _part("style.css")
    template = Environment(autoescape=True, undefined=StrictUndefined).from_string(_part("page.html.jinja"))
    return template.render(
        title=contents.title,
        policy=_policy(script, style),
        style=Markup(style),
        script=Markup(script),
        contents=Markup(as_data(contents)),
    )


def as_data(contents: PageContents) -> str:
    """Write the contents as JSON that may stand in HTML."""
    return json_in_html(json.dumps(to_json(contents), allow_nan=False, separators=(",", ":")))


def json_in_html(text: str) -> str:
    """Escape what could end a script element or open a comment in JSON of ASCII; it stays the same value."""
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@cache
def _part(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def _policy(script: str, style: str) -> str:
    """Allow this very script, this very style, and images that lie in the page."""
    rules = {
        "default-src": "'none'",
        "script-src": _hash(script),
        "style-src": _hash(style),
        "img-src": "data:",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return "; ".join(f"{name} {value}" for name, value in rules.items())


def _hash(text: str) -> str:
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"'sha256-{digest}'"
