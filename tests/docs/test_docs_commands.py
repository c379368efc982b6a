"""Promise: a search that README or a page tells to type has all that it needs, a choice of the model among it."""

import re
import shlex

import pytest
from checkout import ROOT

from tacevo.config.compose import compose, compose_estimate, spread
from tacevo.config.folder import check_experiment

#: Written on purpose with a part left out, or with a task that `tacevo init` makes first.
NOT_WHOLE = re.compile(r" \.\.\.| @|task=shear")


def searches() -> list[str]:
    """List the commands of all pages that begin a search, each in one line and without its comment."""
    found = []
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        found += re.findall(r"^    .*?(tacevo search [^#\n]+)", text, flags=re.MULTILINE)
    return [command.strip() for command in found if not NOT_WHOLE.search(command)]


@pytest.mark.few(12)
@pytest.mark.parametrize("command", dict.fromkeys(searches()))
def test_written_search_can_be_typed(command: str) -> None:
    """Every value of every setting; an estimate needs no model."""
    words = shlex.split(command)[2:]
    if "--estimate" not in words:
        check_experiment(words)
    values = spread([word for word in words if "=" in word and not word.startswith("hydra")])
    for number in range(max(map(len, values))):
        overrides = [one[min(number, len(one) - 1)] for one in values]
        (compose_estimate if "--estimate" in words else compose)(overrides)
