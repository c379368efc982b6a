"""Write the pages of the site: those of docs/, README and its sisters, the notebooks, and what is taken from the code.

    python docs/site/pages.py build/docs/pages

A link to another page leads to it. A link to any other file of the checkout becomes its name: the site has no sources.
"""

import ast
import contextlib
import dataclasses
import inspect
import io
import json
import os
import re
import shutil
import sys
from enum import EnumType
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import costs
import gallery
import house
import matplotlib as mpl
import matplotlib.pyplot as plt
from annotated_types import Ge, Gt, Le, Lt

from tacevo.cli.app import main
from tacevo.config.comments import comments
from tacevo.config.compose import compose
from tacevo.parts.kinds import COMMAND_GROUPS
from tacevo.records import to_json

ROOT = Path(__file__).resolve().parents[2]

#: Pages that lie elsewhere in the checkout, and where the site has them.
ELSEWHERE = {
    "docs/site/front.md": "index.md",
    "docs/site/gallery.md": "gallery.md",
    "README.md": "first_search.md",
    "docs/index.md": "where_to_read.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "benchmarks.md",
    "cache/README.md": "stores.md",
    "cache/published/README.md": "published_runs.md",
    "conf/library/README.md": "library.md",
    "docs/plans/README.md": "plans.md",
    "docs/found/README.md": "found/index.md",
    "examples/tacevo_lexicase/README.md": "example_package.md",
    "docs/notebooks": "notebooks/read_a_published_run.md",
}

#: Where pictures lie that pages show, and schemas.
PICTURES = ("docs/figures/", "docs/found/", "docs/schemas/")

#: Stands above a page that no search shall find: the changelog has every word of every page.
UNSEARCHED = "---\nsearch:\n  exclude: true\n---\n\n"

#: What a bound of a setting is called.
WORDS = {Ge: "at least", Gt: "above", Le: "at most", Lt: "below"}

#: The Python API's places, in the order of its page.
PYTHON = {
    "api.opening": ["open"],
    "api.runs": ["Run"],
    "api.studies": ["Study"],
    "api.sweeps": ["Sweep"],
    "api.tables": ["Table"],
    "api.actions": ["search", "study", "noise", "publish"],
    "errors": ["TacevoError", "ConfigError", "RunError", "BundleError", "DivergenceError", "CacheMissError"],
}


def write_pages(folder: Path) -> None:
    """Write every page below a folder, which is emptied first."""
    shutil.rmtree(folder, ignore_errors=True)
    for pictures in ("figures", "found", "schemas"):
        shutil.copytree(
            ROOT / "docs" / pictures, folder / pictures, ignore=shutil.ignore_patterns("*.py", "*.md", "__pycache__")
        )
    put(folder / "assets/phone.css", (ROOT / "docs/site/phone.css").read_text(encoding="utf-8"))
    put(folder / "assets/iframe-worker.js", (ROOT / "docs/site/worker.js").read_text(encoding="utf-8"))
    house.write(folder / "figures/house.svg")
    places = places_of_pages()
    for source, place in places.items():
        if source.endswith(".md"):
            text = (ROOT / source).read_text(encoding="utf-8")
            text = costs.counted(text) if ROOT / source == costs.PAGE else text
            text = with_links(text, source, places)
            put(folder / place, UNSEARCHED + text if source == "CHANGELOG.md" else text)
    with (folder / places["docs/site/gallery.md"]).open("a", encoding="utf-8") as page:
        page.write(f"\n{gallery.write(ROOT, folder / 'gallery')}")
    for notebook in sorted((ROOT / "docs/notebooks").glob("*.ipynb")):
        source = notebook.relative_to(ROOT).as_posix()
        put(folder / places[source], run_notebook(notebook, folder / "notebooks", places))
    put(folder / "reference/commands.md", commands())
    put(folder / "reference/settings.md", settings())
    put(folder / "reference/python.md", python())


def put(path: Path, text: str) -> None:
    """Write a file, with its directory."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def places_of_pages() -> dict[str, str]:
    """Return the site's place of every page, by its path in the checkout."""
    places = {}
    for path in (*sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "docs/notebooks").glob("*.ipynb"))):
        places[path.relative_to(ROOT).as_posix()] = path.relative_to(ROOT / "docs").with_suffix(".md").as_posix()
    return places | ELSEWHERE


def with_links(text: str, source: str, places: dict[str, str]) -> str:
    """Return the text of a page of the checkout with its links as the site has them.

    Raises:
        FileNotFoundError: a link leads to no file of the checkout.
    """

    def lead(link: re.Match[str]) -> str:
        words, target, part = link["words"], link["target"], link["part"] or ""
        if not target or "://" in target:
            return link[0]
        path = (ROOT / source).parent.joinpath(target).resolve(strict=True).relative_to(ROOT).as_posix()
        place = places.get(path, path.removeprefix("docs/") if path.startswith(PICTURES) else None)
        if place is None:
            return f"`{path}`"
        return f"[{words}]({os.path.relpath(place, Path(places[source]).parent)}{part})"

    return re.sub(r"\[(?P<words>[^\[\]]*)\]\((?P<target>[^)#\s]*)(?P<part>#[^)]*)?\)", lead, text)


def run_notebook(notebook: Path, folder: Path, places: dict[str, str]) -> str:
    """Run a notebook's cells as Jupyter does; return them with what they show. Figures are written into the folder."""
    mpl.use("agg")
    space: dict[str, object] = {"__name__": "__main__"}
    parts = []
    with contextlib.chdir(notebook.parent):
        for number, cell in enumerate(json.loads(notebook.read_text(encoding="utf-8"))["cells"]):
            text = "".join(cell["source"])
            if cell["cell_type"] == "markdown":
                parts.append(with_links(text, notebook.relative_to(ROOT).as_posix(), places))
                continue
            parts.append(f"```python\n{text}\n```")
            printed, value = run_cell(text, space)
            if printed.strip():
                parts.append(f"```text\n{printed.strip()}\n```")
            if plt.get_fignums():
                picture = f"{notebook.stem}_{number}.png"
                folder.mkdir(parents=True, exist_ok=True)
                plt.gcf().savefig(folder / picture, dpi=120, bbox_inches="tight")
                plt.close("all")
                parts.append(f"![the figure that this cell draws]({picture})")
            elif (drawn := _drawn(value)) is not None:
                name = f"{notebook.stem}_{number}.png"
                folder.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(drawn)
                parts.append(f"![the figure that this cell draws]({name})")
            elif value is not None:
                html = getattr(value, "_repr_html_", lambda: None)()
                parts.append(html or f"```text\n{value!r}\n```")
    return "\n\n".join(parts) + "\n"


def _drawn(value: object) -> bytes | None:
    """Return the PNG that Jupyter would show of a value; None where it would show none."""
    picture = getattr(value, "_repr_png_", lambda: None)()
    return picture if isinstance(picture, bytes) else None


def run_cell(text: str, space: dict[str, object]) -> tuple[str, object]:
    """Run a cell; return what it printed and the value of its last line, None where that is no expression."""
    body = ast.parse(text).body
    last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(ast.Module(body, []), "<cell>", "exec"), space)
        value = eval(compile(ast.Expression(last.value), "<cell>", "eval"), space) if last else None
    return printed.getvalue(), value


def commands() -> str:
    """Return the help of every command, by group."""
    parts = ["# Commands"]
    for title, group in COMMAND_GROUPS.items():
        parts.append(f"## {title.capitalize()}")
        for name in group:
            parts.append(f"### tacevo {name}\n\n```text\n{help_of(name).rstrip()}\n```")
    return "\n\n".join(parts) + "\n"


def help_of(command: str) -> str:
    """Return what a command says of itself."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        main([command, "--help"])
    return printed.getvalue()


def settings() -> str:
    """Return every setting of a run: what it may be, its default, and the comment beside it in the schema."""
    words = comments()
    config = compose(["llm=grammar"])
    parts = [
        "# Settings",
        "`tacevo search GROUP.NAME=VALUE`. A default is that of `tacevo search llm=grammar`; `tacevo search --help` "
        "lists the choices of each group.",
    ]
    for field in dataclasses.fields(config):
        group = getattr(config, field.name)
        if not dataclasses.is_dataclass(group):
            continue
        kinds = get_type_hints(type(group), include_extras=True)
        rows = ["| setting | value | default | |", "|---|---|---|---|"]
        for name in (setting.name for setting in dataclasses.fields(group)):
            value = getattr(group, name)
            default = json.dumps(to_json(value), ensure_ascii=False)
            key = f"{field.name}.{name}"
            cells = (f"`{key}`", kind_of(kinds[name]), f"`{default}`", words[key])
            rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
        parts += [f"## {field.name}", inspect.getdoc(group) or "", "\n".join(rows)]
    return "\n\n".join(parts) + "\n"


def kind_of(kind: Any) -> str:
    """Say what a setting may be: a type with its bounds, or the names of its choices."""
    if isinstance(kind, EnumType):
        return ", ".join(f"`{name}`" for name in kind.__members__)
    parts = get_args(kind)
    if get_origin(kind) is Annotated:
        bounds = [
            f"{WORDS[type(rule)]} {getattr(rule, type(rule).__name__.lower()):,}"
            for rule in parts[1:]
            if type(rule) in WORDS
        ]
        return ", ".join([kind_of(parts[0]), *bounds])
    if get_origin(kind) in (Union, UnionType):
        return " or ".join("null" if part is NoneType else kind_of(part) for part in parts)
    if get_origin(kind) is Literal:
        return ", ".join(f"`{part}`" for part in parts)
    return f"list of {kind_of(parts[0])}" if get_origin(kind) is tuple else getattr(kind, "__name__", str(kind))


def python() -> str:
    """Return the page on which mkdocstrings writes the docstrings of the public names."""
    places = [f"::: tacevo.{module}.{name}" for module, names in PYTHON.items() for name in names]
    return "\n\n".join(["# Python", "Columns of every frame: [From Python](../python.md).", *places]) + "\n"


if __name__ == "__main__":
    write_pages(Path(sys.argv[1]).resolve())
