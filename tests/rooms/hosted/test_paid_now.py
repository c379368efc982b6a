"""Promise: what is asked and paid now is said, apart from what the record cost; and whom a run goes on to ask.

The searches are real, and as small as they can be; a server in this process answers them.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from llm_script import Script
from llm_server import LLMServer, serving
from refusals import refused
from smallest import ARCHIVES, TOUCHES, UNTRACKED
from test_model_search import network

from tacevo.cli.app import main
from tacevo.config.compose import compose
from tacevo.errors import ConfigError
from tacevo.records import Delivery
from tacevo.runs.providers import load_prices, prices_of

pytestmark = pytest.mark.usefixtures("keys")

TINY = [
    *TOUCHES,
    *ARCHIVES,
    UNTRACKED,
    "llm=anthropic",
    "search.generations=0",
    "search.candidates=1",
    "search.initial=2",
]

#: Three lines, as docs/llm.md shows them; an answer of the server costs 11 + 7 of such tokens, 18 USD.
TABLE = """\
batch_factor: 0.5
models:
  claude-haiku-4-5: {input_usd: 1000000, output_usd: 1000000, dated: "2026-11-27", source: our proxy}
"""


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[LLMServer]:
    """Serve networks, where no SDK is told of another server."""
    for name in ("ANTHROPIC_BASE_URL", "OPENAI_BASE_URL"):
        monkeypatch.delenv(name, raising=False)
    with serving(Script(answer=network)) as server:
        yield server


def test_rerun_says_what_was_asked_and_paid_now(
    server: LLMServer, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing, where the store answers; the rest, where a longer search asks on. The summary has the record's cost."""
    Path("prices.yaml").write_text(TABLE)
    search = ["search", *TINY, f"llm.base_url={server.url}", "llm.prices=prices.yaml"]
    said = []
    for more in (["run.dir=one"], ["run.dir=two"], ["run.dir=two", "search.generations=1"]):
        asked = len(server.bodies)
        assert main([*search, *more]) == 0
        said.append((len(server.bodies) - asked, capsys.readouterr().out))
    for (asked, text), words in zip(
        said,
        [
            "2 asked, 0 from the store, 36.00 USD",
            "0 asked, 2 from the store, 0.00 USD",
            "1 asked, 2 from the store, 18.00",
        ],
        strict=True,
    ):
        assert f"{asked} asked" in words
        assert words in text
    assert "36.00 USD" in said[1][1]  # what the record cost


def test_prices_are_read_where_one_stands(place: Path) -> None:
    """By whatever relative name, that of the shipped table, too; else below conf/; and what is nowhere is named."""
    other = [*TINY, "llm.base_url=http://127.0.0.1:1"]
    for name in ("prices.yaml", "./mine.yaml", "deep/er/../mine.yaml", f"{place}/mine.yaml"):
        path = Path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(TABLE)
        price = prices_of(compose([*other, f"llm.prices={name}"]).llm).price("claude-haiku-4-5", Delivery.direct)
        assert price is not None
        assert price.input_usd == 1e6
    assert compose(other).llm.prices == "prices.yaml"  # not the one that happens to lie here
    with refused(ConfigError, place="llm.prices=absent.yaml", expected="in the working directory or below conf/"):
        load_prices(compose([*other, "llm.prices=absent.yaml"]).llm.prices)
    assert yaml.safe_load(TABLE)["models"].keys() == {"claude-haiku-4-5"}


def test_extended_run_says_whom_it_asks_and_what_may_be_paid_before_it_asks(
    server: LLMServer, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run that another server answered goes on to ask the provider's own unless that server is named again."""
    Path("prices.yaml").write_text(TABLE)
    assert main(["search", *TINY, f"llm.base_url={server.url}", "run.dir=one", "llm.prices=prices.yaml"]) == 0
    (place / "one" / "candidates" / "g00s00.py").write_text("# edited")  # so that the replay stops before it asks
    asked = len(server.bodies)
    extend = ["extend", "one", "search.generations=2", UNTRACKED, "llm.prices=prices.yaml", "run.dir=two"]
    capsys.readouterr()
    assert main(extend) == 1
    said = capsys.readouterr().err
    assert "asking claude-haiku-4-5-20251001 at api.anthropic.com" in said
    assert "not the server that answered so far" in said
    assert "up to 2 requests: some 36.00 USD" in said
    assert "no limit" in said
    address = server.url.replace("://", "://user:word@")
    assert main([*extend, f"llm.base_url={address}", "llm.budget_usd=500"]) == 1
    said = capsys.readouterr().err
    assert f"at {server.url.replace('://', '://***@')}" in said
    assert "answered so far (" not in said
    assert "at most 500 USD in all" in said
    assert main([*extend[:4], "run.dir=two", f"llm.base_url={server.url}"]) == 1  # whose price nobody gave
    assert "what they cost is not known" in capsys.readouterr().err
    assert len(server.bodies) == asked
