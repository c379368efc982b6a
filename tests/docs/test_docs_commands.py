"""Promise: what a page tells to type can be typed."""

import re
import shlex

import pytest
from checkout import ROOT

from tacevo.cli.app import _parsed
from tacevo.config.compose import compose, compose_estimate, spread
from tacevo.config.conf_folder import check_experiment

PAGES = (
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *(ROOT / folder / "README.md" for folder in ("benchmarks", "cache", "cache/published")),
)

#: Written on purpose with a part left out, or with a task that `tacevo init` makes first.
NOT_WHOLE = re.compile(r"\.\.\.| @|task=(shear|\w+-paper)")


def commands() -> list[str]:
    """List the commands of all pages: without comments and optional words, and with the first of several choices."""
    lines: list[str] = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        lines += re.findall(r"^    (?:.*[ /])?(tacevo [a-z][^#\n]+)", text, flags=re.MULTILINE)
    whole = [re.sub(r" \[.*?\]|\|[A-Z]\S*", "", line).strip() for line in lines]
    return [line for line in dict.fromkeys(whole) if not NOT_WHOLE.search(line)]


@pytest.mark.few(30)
@pytest.mark.parametrize("command", commands())
def test_written_command_can_be_typed(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command line reads it; every value of a search's settings is composed; an estimate needs no model."""
    monkeypatch.setattr("tacevo.cli.arguments.check_place", lambda path: None)  # runs/NAME is not there
    words = shlex.split(command)[1:]
    _parsed(words)
    if words[0] != "search":
        return
    if "--estimate" not in words:
        check_experiment(words)
    values = spread([word for word in words if "=" in word and not word.startswith("hydra")])
    for number in range(max(map(len, values))):
        overrides = [one[min(number, len(one) - 1)] for one in values]
        (compose_estimate if "--estimate" in words else compose)(overrides)
