"""Promise: contenders get the same answers once and in order, and one that trained something else is refused."""

import json
import sys
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from benchmarks.peers import check_trained, in_order, published, search_cost, serving


def ask(url: str) -> str:
    """Ask the server something; it does not matter what."""
    request = urllib.request.Request(
        f"{url}/chat/completions", data=json.dumps({"messages": [{"content": "any"}]}).encode()
    )
    with urllib.request.urlopen(request) as answer:
        return str(json.load(answer)["choices"][0]["message"]["content"])


def test_server_gives_each_answer_once_in_order() -> None:
    """Every search gets the same networks, fenced as a model's; one request too many is an error."""
    with serving(in_order(["first\n", "second\n"])) as url:
        assert [ask(url), ask(url)] == ["```python\nfirst\n```", "```python\nsecond\n```"]
        with pytest.raises(urllib.error.HTTPError) as refusal:
            ask(url)
        refusal.value.close()


def test_published_networks_are_distinct() -> None:
    """Equal sources would share one training of ours, and the peer would train them twice."""
    sources = published(40)
    assert len(set(map(str.strip, sources))) == 40


@pytest.mark.parametrize("texts", [["a"], ["a", "b", "b"], ["a", "c"]])
def test_contender_that_trained_something_else_is_refused(texts: list[str], tmp_path: Path) -> None:
    """Whoever leaves a network out, or trains one twice or another one, did not have the same work."""
    files = [tmp_path / f"{number}.py" for number in range(len(texts))]
    for file, text in zip(files, texts, strict=True):
        file.write_text(text, encoding="utf-8")
    with pytest.raises(RuntimeError, match="peer trained"):
        check_trained("peer", files, ["a", "b"])


@pytest.mark.slow
def test_cost_counts_processes_below_the_command(tmp_path: Path) -> None:
    """A worker's memory is its search's."""
    worker = "import time; block = bytearray(200_000_000); time.sleep(1.5)"
    script = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {worker!r}], check=True)"
    assert search_cost([sys.executable, "-c", script], {}).memory > 200


def test_failed_contender_shows_its_output() -> None:
    """A broken peer is not a quick one."""
    with pytest.raises(RuntimeError, match="no such thing"):
        search_cost([sys.executable, "-c", "exit('no such thing')"], {})
