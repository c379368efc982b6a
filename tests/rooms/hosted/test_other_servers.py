"""Promise: what another server answered is said to be its word; neither its address nor a path of it is published.

The searches are real, and as small as they can be; servers in this process answer them.
"""

import functools
import json
import lzma
from dataclasses import replace
from pathlib import Path

import pytest
from bundles import members_of
from llm_script import Script, text_of
from llm_server import LLMServer, serving
from raw_server import Reply, replying
from refusals import refused
from smallest import ARCHIVES, TOUCHES, UNTRACKED
from test_answers import chat, without
from test_model_search import network

from tacevo.bundles.format import STORE
from tacevo.cli.app import main
from tacevo.config.compose import compose
from tacevo.config.schema import LLMConfig
from tacevo.errors import ConfigError
from tacevo.records import Mode
from tacevo.runs.providers import asks_elsewhere, build_llm
from tacevo.storage.canonical import value_at
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys")

TINY = [
    *TOUCHES,
    *ARCHIVES,
    UNTRACKED,
    "search.generations=0",
    "search.initial=2",
    "executor.workers=2",
    "llm.concurrency=1",
]

CLAUDE = "claude-haiku-4-5-20251001"

SAID = f"{CLAUDE}, asked through another server, under this name"

#: Where a model of a server without aliases lies.
PATH = "/srv/secret-user/models/llama"


@pytest.fixture(autouse=True)
def _no_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin where no SDK is told of another server."""
    for name in ("ANTHROPIC_BASE_URL", "OPENAI_BASE_URL"):
        monkeypatch.delenv(name, raising=False)


def plain(text: str | bytes) -> str:
    """Return a text with its lines joined."""
    return " ".join((text if isinstance(text, str) else text.decode(errors="replace")).split())


def published(run: str) -> dict[str, bytes]:
    """Publish a run, replay the bundle, and return its members, the store unpacked."""
    assert main(["publish", run, "-o", "run.zip", "--author", "A. Nyone"]) == 0
    assert main(["replay", "run.zip"]) == 0
    members = members_of(Path("run.zip"))
    return {**members, STORE: lzma.decompress(members[STORE])}


def check_said(run: str, members: dict[str, bytes], server: LLMServer, capsys: pytest.CaptureFixture[str]) -> None:
    """Check that every page says whose word the model's name is, and that none has the server's address."""
    for name in ("README.md", "CITATION.cff", "ro-crate-metadata.json", "run/summary.md"):
        assert SAID in plain(members[name]), name
    for name, data in members.items():
        assert server.url.rpartition("/")[2].encode() not in data, name
        assert b"the language model" not in data, name
    assert "price unknown" in members["run/summary.md"].decode()
    capsys.readouterr()
    assert main(["show", run]) == 0
    assert SAID in capsys.readouterr().out
    assert main(["report", run, "-o", "report.html"]) == 0
    assert SAID in plain(Path("report.html").read_text(encoding="utf-8"))


def test_name_that_another_server_gave_is_said_to_be_so(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A proxy with canned answers is not Claude, and nobody paid."""
    with serving(Script(answer=network)) as server:
        assert main(["search", *TINY, "llm=anthropic", "run.dir=run", f"llm.base_url={server.url}"]) == 0
        assert "price unknown" in capsys.readouterr().out
    check_said("run", published("run"), server, capsys)


@pytest.mark.slow
def test_server_that_only_the_sdk_was_told_of_is_another_one(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its variable counts; and a later run that finds these answers in the store says the same and asks nobody."""
    with serving(Script(answer=network)) as server:
        monkeypatch.setenv("ANTHROPIC_BASE_URL", server.url)
        assert main(["search", *TINY, "llm=anthropic", "run.dir=run"]) == 0
        assert len(server.bodies) == 2
    monkeypatch.delenv("ANTHROPIC_BASE_URL")
    assert main(["search", *TINY, "llm=anthropic", "run.dir=again", "llm.mode=replay"]) == 0
    for run in ("run", "again"):
        assert SAID in (place / run / "summary.md").read_text()
        assert json.loads((place / run / "run.json").read_text())["elsewhere"] is True


@pytest.mark.slow
def test_run_of_an_earlier_release_says_so_when_it_is_published(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It recorded the address alone; until then it replays as it was written."""
    with serving(Script(answer=network)) as server:
        assert main(["search", *TINY, "llm=anthropic", "run.dir=run", f"llm.base_url={server.url}"]) == 0
    described = json.loads((place / "run" / "run.json").read_text())
    assert described.pop("elsewhere") is True
    (place / "run" / "run.json").write_text(json.dumps(described))
    summary = (place / "run" / "summary.md").read_text()
    (place / "run" / "summary.md").write_text(summary.replace(SAID, CLAUDE))
    assert main(["replay", "run"]) == 0
    members = published("run")
    assert SAID in plain(members["README.md"])
    assert SAID in members["run/summary.md"].decode()


@functools.cache
def chosen_of(provider: str) -> LLMConfig:
    """Compose the choice of a provider."""
    return compose([f"llm={provider}", "llm.model=m"]).llm


@pytest.mark.parametrize(
    ("provider", "address", "elsewhere"),
    [
        ("anthropic", None, False),
        ("anthropic", "https://api.anthropic.com", False),
        ("anthropic", "https://api.anthropic.com:443/", False),
        ("anthropic", "http://api.anthropic.com", True),
        ("anthropic", "https://api.anthropic.com.example", True),
        ("anthropic", "https://api.openai.com/v1", True),
        ("openai", None, False),
        ("openai", "https://eu.api.openai.com/v1", False),
        ("openai", "http://localhost:8000/v1", True),
    ],
)
def test_own_servers_of_a_provider_are_known(
    provider: str, address: str | None, elsewhere: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the setting and by the SDK's variable; the setting counts before it."""
    chosen = chosen_of(provider)
    assert asks_elsewhere(chosen) is False
    assert asks_elsewhere(replace(chosen, base_url=address)) is elsewhere
    monkeypatch.setenv(f"{provider.upper()}_BASE_URL", address or "")
    assert asks_elsewhere(chosen) is elsewhere


@pytest.mark.room("estimate")
def test_price_of_another_server_is_the_users_to_give(place: Path) -> None:
    """The provider's prices say nothing of it: no budget, no estimate."""
    from tacevo.runs.estimate import describe_cost

    other = [*TINY, "llm=anthropic", "llm.base_url=http://127.0.0.1:1"]
    config = compose([*other, "llm.budget_usd=5"])
    with refused(ConfigError, place="llm.budget_usd", got="other servers", remedy="llm.prices=FILE"):
        build_llm(config, Mode.record)
    assert describe_cost(config).count("unknown") == 2
    price = {"input_usd": 1, "output_usd": 1, "dated": "2026-11-21", "source": "this test"}
    table = {"batch_factor": 1, "models": {CLAUDE: price}}
    (place / "mine.yaml").write_text(json.dumps(table))
    assert build_llm(compose([*other, "llm.budget_usd=5", f"llm.prices={place}/mine.yaml"]), Mode.record)


@pytest.mark.slow
def test_path_as_a_models_name_is_told_and_a_label_stands_for_it(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A warning at the start, no publication without a label; with one the same answers serve, without the path.

    The server is asked by the path, and answers by a path; a new answer is recorded under the label, too.
    """
    with serving(Script(answer=network)) as server:
        command = [*TINY, "llm=openai", f"llm.model={PATH}", f"llm.base_url={server.url}/v1"]
        assert main(["search", *command, "run.dir=run"]) == 0
        assert "set llm.label=NAME" in capsys.readouterr().err
        assert main(["publish", "run", "-o", "no.zip"]) == 2
        assert f"got {PATH}; repeat the search with llm.label=NAME" in capsys.readouterr().err
        assert not (place / "no.zip").exists()
        asked = len(server.bodies)
        assert main(["search", *command, "llm.label=llama-8b", "run.dir=labelled"]) == 0
        assert "llm.label" not in capsys.readouterr().err
        assert len(server.bodies) == asked
        more = ["llm.label=llama-8b", "search.initial=3", "run.dir=more", "store.root=other"]
        assert main(["search", *command, *more]) == 0
        assert {body["model"] for body in server.bodies} == {PATH}
        assert len(server.bodies) == asked + 3
    members = published("labelled")
    assert [name for name, data in members.items() if b"secret-user" in data] == []
    assert "llama-8b, asked through another server, the name is a label" in plain(members["README.md"])
    assert json.loads(members["run/run.json"])["config"]["llm"]["model"] == "llama-8b"
    for entry in Store(place / "other", "completions").entries():
        assert {value_at(told, ("model",)) for told in (entry.request, entry.answer)} == {"llama-8b"}


@pytest.mark.slow
def test_path_that_only_the_server_says_is_not_published_either(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Asked by an alias, it answers by the path of the file that it has loaded."""
    with replying((200, chat(content=network({"messages": [1, 2]}), model=PATH))) as server:
        command = [*TINY, "llm=openai", "llm.model=default", f"llm.base_url={server.url}/v1"]
        assert main(["search", *command, "run.dir=run"]) == 0
        assert main(["publish", "run", "-o", "run.zip"]) == 2
        assert f"got {PATH}" in capsys.readouterr().err
        assert main(["search", *command, "llm.label=llama-8b", "run.dir=labelled"]) == 0
        assert len(server.bodies) == 2
    answers = [entry.answer for entry in Store(place / "cache", "completions").entries()]
    assert sorted(str(value_at(answer, ("model",))) for answer in answers) == [PATH, PATH, "llama-8b", "llama-8b"]


@pytest.mark.slow
def test_model_without_a_system_prompt_is_asked_in_one_turn(
    place: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    """The refusal names the setting; with it the texts are joined, which the ledger says, and the replay finds.

    The server counts no tokens and names no model: each answer is asked for once, and what is unknown is said.
    """
    answer = without(chat(content=[{"type": "text", "text": network({"messages": [1, 2]})}], model=None), "usage")

    def reply(body: dict[str, object], number: int) -> Reply:
        first = body["messages"][0]  # type: ignore[index]
        return (200, answer) if first["role"] != "system" else (400, {"message": "System role not supported"})

    with replying(reply) as server:
        command = [*TINY, "llm=openai", "llm.model=m", f"llm.base_url={server.url}/v1", "run.dir=run"]
        assert main(["search", *command]) == 2
        assert "set llm.system=user" in capsys.readouterr().err
        refused_ones = len(server.bodies)
        assert main(["search", *command, "llm.system=user", "run.dir=user"]) == 0
        told = capsys.readouterr().out
        assert main(["search", *command, "llm.system=user", "run.dir=user"]) == 0
        assert len(server.bodies) == refused_ones + 2
    system, instructed = (str(server.bodies[number]["messages"][0]["content"]) for number in (0, -1))
    assert text_of(server.bodies[-1]) == instructed
    assert instructed.startswith(f"{system}\n\n")
    assert "2 answers, tokens unknown, price unknown" in told
    assert [record.getMessage().count("answers do not tell") for record in caplog.records] == [1, 1]
    header = json.loads((place / "user" / "ledger.jsonl").read_text().splitlines()[0])
    assert header["config"]["llm"]["system"] == "user"
    capsys.readouterr()
    assert main(["replay", "user"]) == 0
    assert "2 answers, tokens unknown" in capsys.readouterr().out
