"""Promise: what a model takes is asked once, recorded and checked; a setting that is refused costs one request.

The real SDKs talk to a server in this process, which takes the part of a model of today.
"""

import json
import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from anthropic.resources.messages import DEPRECATED_MODELS
from asked import KEY, request
from bundles import entries_of, members_of
from commands import publish
from hosted import batched, hosted
from llm_models import MODELS
from llm_script import Script
from llm_server import LLMServer, serving
from refusals import refused
from smallest import ARCHIVES, PUBLISHED_SIZES, TOUCHES, UNTRACKED

from tacevo.choices import Effort
from tacevo.cli.app import main
from tacevo.errors import ConfigError
from tacevo.llm.anthropic import ClaudeCatalogue
from tacevo.llm.capabilities import Capabilities, recorded_capabilities
from tacevo.records import Delivery, Setting
from tacevo.runs.providers import load_prices
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys")

TINY = [
    *TOUCHES,
    *ARCHIVES,
    UNTRACKED,
    "llm=anthropic",
    *PUBLISHED_SIZES,
    "executor.workers=2",
    "run.dir=run",
]

HAIKU = "claude-haiku-5-5"

CURRENT = Script(like={HAIKU: MODELS[HAIKU]})


def search(server: LLMServer, *overrides: str) -> int:
    """Search with a server; return the exit status."""
    return main(["search", *TINY, f"llm.base_url={server.url}", *overrides])


def digest(out: str) -> str:
    """Take the digest from the last line of what a command wrote."""
    return out.splitlines()[-1].removeprefix("digest: ")


def answered(place: Path) -> list[dict[str, Any]]:
    """Read the ledger's lines of candidates that a model was asked for."""
    lines = map(json.loads, (place / "run" / "ledger.jsonl").read_text().splitlines())
    return [line for line in lines if line.get("answer")]


@pytest.mark.parametrize(
    ("setting", "field", "sent"),
    [
        (("effort", "xhigh"), "output_config", {"effort": "xhigh"}),
        (("thinking", "adaptive"), "thinking", {"type": "adaptive"}),
        (("thinking", "disabled"), "thinking", {"type": "disabled"}),
        (("thinking", 2048), "thinking", {"type": "enabled", "budget_tokens": 2048}),
        (("thinking_tokens", 2048), "thinking", {"type": "enabled", "budget_tokens": 2048}),
    ],
)
def test_effort_and_thinking_are_sent_as_the_messages_api_has_them(
    setting: tuple[str, Setting], field: str, sent: dict[str, Any]
) -> None:
    """Under its field, and under no other; a request that lets the model think has no temperature, and says so."""
    with serving() as server:
        ((_, completion),) = hosted(server.url).complete([request("a", settings=(setting,))])
    (body,) = server.bodies
    thinks = setting[0] == "thinking" and setting[1] != "disabled"
    assert body[field] == sent
    assert {"effort", "thinking_tokens"}.isdisjoint(body)
    assert ("temperature" in body) is not thinks
    assert completion.dropped == (("temperature",) if thinks else ())


def test_effort_is_sent_as_the_chat_completions_api_has_it() -> None:
    """By the name that the servers of that API know."""
    with serving() as server:
        list(hosted(server.url, "openai").complete([request("a", settings=(("effort", "low"),))]))
    (body,) = server.bodies
    assert body["reasoning_effort"] == "low"
    assert "effort" not in body


@pytest.mark.room("publishing")
def test_model_is_asked_about_once_and_the_answer_is_recorded_and_replayed(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Once in a run, never where it is recorded, and never in a replay of the run or of its bundle, which has it."""
    with serving(CURRENT) as server:
        chosen = [f"llm.model={HAIKU}", "llm.effort=low", "llm.thinking=adaptive", "search.generations=2"]
        chosen += ["temperature.carrier=none"]  # the model takes no temperature
        assert search(server, *chosen) == 0
        recorded = digest(capsys.readouterr().out)
        assert server.asked_about == [HAIKU]
        assert search(server, *chosen, "run.dir=other", "seed=1") == 0
        assert server.asked_about == [HAIKU]
    known = recorded_capabilities(Store(place / "cache", "models"), "anthropic", HAIKU)
    assert known == Capabilities(temperature=False, efforts=tuple(Effort), thinkings=("adaptive", "disabled"))
    capsys.readouterr()
    assert main(["replay", "run"]) == 0
    assert digest(capsys.readouterr().out) == recorded
    assert not [line for line in answered(place) if "dropped" in line]
    publish("run", "-o", "run.zip", "--author", "A. Name", cwd=place)
    assert [entry["kind"] for entry in entries_of(members_of(place / "run.zip"))].count("models") == 1
    capsys.readouterr()
    assert main(["replay", "run.zip"]) == 0
    assert digest(capsys.readouterr().out) == recorded


def test_each_server_is_asked_about_its_own_model(place: Path) -> None:
    """Another server may know another model by the name; its address is in no entry, and a bundle has its word."""
    chosen = [f"llm.model={HAIKU}", "search.generations=0", "temperature.carrier=none"]
    with serving(CURRENT) as first, serving(CURRENT) as second:
        assert search(first, *chosen) == 0
        assert search(second, *chosen, "run.dir=other", "seed=1") == 0
        assert search(second, *chosen, "run.dir=third", "seed=2") == 0
        assert (first.asked_about, second.asked_about) == ([HAIKU], [HAIKU])
        texts = [path.read_text(encoding="utf-8") for path in (place / "cache" / "models").rglob("*.json")]
        assert len(texts) == 2
        assert not [text for text in texts for server in (first, second) if server.url.rpartition("/")[2] in text]
    for run in ("run", "other"):
        assert main(["replay", run]) == 0


@pytest.mark.parametrize(
    ("model", "chosen", "expected"),
    [
        (HAIKU, "llm.thinking=1024", "adaptive, disabled, or null"),
        ("claude-opus-5-5", "llm.thinking=disabled", "adaptive, or null"),
        ("claude-haiku-4-5", "llm.thinking=adaptive", "disabled, a number of tokens, or null"),
        ("claude-haiku-4-5", "llm.effort=low", "null"),
        (HAIKU, "llm.thinking_tokens=1024", "adaptive, disabled, or null"),
    ],
)
def test_what_the_model_does_not_take_is_told_before_the_first_request(
    model: str, chosen: str, expected: str, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By its name, with what can stand there; nothing is sent."""
    with serving(Script(like={model: MODELS[model]})) as server:
        assert search(server, f"llm.model={model}", chosen) == 2
        assert server.bodies == []
    assert f"error: {chosen.partition('=')[0]}: expected {expected}; got " in capsys.readouterr().err
    assert not (place / "cache" / "completions").exists()


@pytest.mark.parametrize("provider", ["anthropic", "openai", "batches"])
@pytest.mark.parametrize(("field", "setting"), [("output_config", ("effort", "max")), ("thinking", ("thinking", 9))])
def test_refusal_of_effort_or_thinking_costs_one_request_and_has_the_name(
    field: str, setting: tuple[str, Setting], provider: str, tmp_path: Path
) -> None:
    """One request goes ahead of the others, which are then not sent."""
    if provider == "openai":
        field, setting = "reasoning_effort", ("effort", "max")
    asked = [request(text, settings=(setting,)) for text in "abcdef"]
    with serving(Script(refused=(field,))) as server:
        llm = batched(server.url, tmp_path) if provider == "batches" else hosted(server.url, provider)
        with refused(ConfigError, place=f"llm.{setting[0]}", got=str(setting[1]), remedy=f"llm.{setting[0]}"):
            list(llm.complete(asked))
        assert server.tried.total() == 1


def test_what_a_model_takes_alone_it_may_refuse_together(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each is told to be taken, so only the server's refusal shows it; that costs one request, too."""
    words = "thinking.type.disabled is not supported with effort xhigh"
    with serving(replace(CURRENT, words=words)) as server:
        chosen = [f"llm.model={HAIKU}", "llm.effort=xhigh", "llm.thinking=disabled", "temperature.carrier=none"]
        assert search(server, *chosen, "search.initial=3") == 2
        assert server.tried.total() == 1
    assert "llm.thinking: expected a value that the model takes; got disabled" in capsys.readouterr().err


@pytest.mark.parametrize("provider", ["anthropic", "batches"])
def test_others_go_at_once_when_the_first_was_answered(provider: str, tmp_path: Path) -> None:
    """What the model has taken once is not in doubt any more, in this round and in the next."""
    asked = [request(text, settings=(("effort", "max"),)) for text in "abcdef"]
    with serving(Script(delay=0.05)) as server:
        llm = batched(server.url, tmp_path) if provider == "batches" else hosted(server.url, concurrency=5)
        assert len(list(llm.complete(asked))) == 6
        if provider == "batches":
            assert [len(batch.requests) for batch in server.batches] == [1, 5]
        else:
            assert server.most == 5
        server.most = 0
        list(llm.complete([request(text, settings=(("effort", "max"),)) for text in "ghijk"]))
        assert [len(batch.requests) for batch in server.batches][2:] == ([5] if provider == "batches" else [])
        assert server.most == (0 if provider == "batches" else 5)


@pytest.mark.parametrize(
    ("words", "place"),
    [
        ("max_tokens: 77 > 64, which is the maximum allowed number of output tokens", "llm.max_tokens"),
        ("max_tokens is too large: 77. This model supports at most 64 completion tokens", "llm.max_tokens"),
        ("stop_sequences: each must contain non-whitespace", "llm.stop_sequences"),
        ('"thinking.type.enabled" is not supported. Use "output_config.effort" instead.', "llm.thinking"),
        ("This model does not support the effort parameter", "llm.effort"),
    ],
)
def test_setting_that_is_refused_ends_no_run_without_its_name(words: str, place: str) -> None:
    """The error names it as the user writes it, the first of those that the server names."""
    settings: tuple[tuple[str, Setting], ...] = (("effort", "low"), ("stop_sequences", ("\n",)), ("thinking", 50))
    with serving(Script(words=words)) as server, refused(ConfigError, place=place, got=words):
        list(hosted(server.url).complete([request(text, settings=settings) for text in "ab"]))


def _nested(depth: int) -> str:
    return '{"capabilities": ' * depth + "1" + "}" * depth


WRONG = {"effort": {"supported": "yes", "low": 1, "max": {"supported": []}}, "thinking": {"types": [{}, 5]}}


@pytest.mark.parametrize(
    ("status", "body"),
    [
        (404, "{}"),
        (401, '{"error": {"message": "no"}}'),
        (429, ""),
        (503, "busy"),
        (200, ""),
        (200, "<html>"),
        (200, "[]"),
        (200, "null"),
        (200, json.dumps({"capabilities": WRONG, "retires_at": 5, "id": None})),
        (200, json.dumps({"id": f"/home/somebody/{KEY}", "retires_at": f"/home/somebody/{KEY}"})),
        (200, '{"capabilities": null, "retires_at": "9999999999-01-01"}'),
        (200, _nested(100_000)),
        (200, '{"id": "' + "x" * 5 * 2**20 + '"}'),
    ],
)
def test_nothing_that_the_models_api_answers_ends_a_run(status: int, body: str, place: Path) -> None:
    """It is asked once, and a server that says nothing of use is as one without it; no text of its is kept."""
    with serving(Script(told=(status, body))) as server:
        assert search(server, "search.generations=0", "llm.effort=low") == 0
        assert len(server.asked_about) == 1
        assert server.bodies[0]["output_config"] == {"effort": "low"}
    assert not (place / "cache" / "models").exists()
    assert not [path for path in place.rglob("*.json*") if "somebody" in path.read_text(encoding="utf-8")]


def test_what_is_told_is_taken_in_part(place: Path) -> None:
    """A kind that is missing or nonsense is unknown; nothing but known words gets into the store."""
    told = {
        "id": KEY,
        "retires_at": "2027-10-07T12:00:00Z",
        "capabilities": {"effort": {"low": {"supported": True}, KEY: {"supported": True}}, "thinking": KEY},
    }
    with serving(Script(told=(200, json.dumps(told)))) as server:
        assert search(server, "search.generations=0", "llm.label=mine", "llm.model=/models/mine") == 0
        assert server.asked_about == ["/models/mine"]
    known = recorded_capabilities(Store(place / "cache", "models"), "anthropic", "mine")
    assert known == Capabilities(efforts=(Effort.low,), retires="2027-10-07")
    (entry,) = (place / "cache" / "models").rglob("*.json")
    assert KEY not in entry.read_text(encoding="utf-8")
    assert "/models" not in entry.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("script", "model", "day"),
    [
        (Script(), "claude-sonnet-4-5", "2026-11-30"),
        (Script(told=(200, '{"retires_at": "2027-10-07T00:00:00Z"}')), "claude-x", "2027-10-07"),
    ],
)
def test_model_that_ends_is_told_with_the_date_before_the_first_request(
    script: Script, model: str, day: str, place: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The SDK knows some ends, the Models API others; it is said once, and the run goes on."""
    said: list[bool] = []

    def answer(body: dict[str, Any]) -> str:
        said.append(any(day in record.getMessage() for record in caplog.records))
        return "no class"

    with caplog.at_level(logging.WARNING), serving(Script(told=script.told, answer=answer)) as server:
        assert search(server, f"llm.model={model}", "search.generations=0") == 0
        assert len(server.bodies) == 2
    assert said == [True, True]
    assert sum(day in record.getMessage() for record in caplog.records) == 1


def test_ends_that_the_sdk_knows_are_those_of_the_price_table() -> None:
    """Every model of the table that the SDK knows to end has that day, by its own name or by that before its date."""
    catalogue, table = ClaudeCatalogue(None), load_prices("prices.yaml")
    ends = {model: catalogue.end(model) for model in DEPRECATED_MODELS if table.price(model, Delivery.direct)}
    assert len(ends) > 3
    assert ends == {model: table.retirement(model) for model in ends}


def test_comparison_of_temperatures_is_not_begun_where_the_model_thinks(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The refusal is the thinking's: it is known before anything was ever answered."""
    with serving(CURRENT) as server:
        assert search(server, f"llm.model={HAIKU}", "llm.thinking=adaptive", "ablation=fixed_temperature") == 2
        assert server.tried.total() == 0
    assert "got llm.thinking=adaptive" in capsys.readouterr().err


@pytest.mark.parametrize("provider", ["anthropic", "batches"])
def test_tokens_of_thinking_are_counted_with_the_answer(provider: str, tmp_path: Path) -> None:
    """What a model thinks is billed as output, and its blocks are no part of the text."""
    asked = [request("a", settings=(("thinking", kind),)) for kind in ("adaptive", "disabled")]
    asked = [replace(each, model=HAIKU) for each in [*asked, request("b")]]
    with serving(CURRENT) as server:
        llm = batched(server.url, tmp_path) if provider == "batches" else hosted(server.url)
        answers = dict(llm.complete(asked))
    assert [answers[position].output_tokens for position in range(3)] == [37, 7, 37]
    assert [answers[position].text for position in range(3)] == ["a!", "a!", "b!"]
