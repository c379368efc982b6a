"""Promise: an answer is recorded as it came, whatever stands where a key should; and a key is written nowhere.

Servers of one's own want no key and are given a word. A key that a server repeats is in no answer, message or log.
"""

import logging
import re
from pathlib import Path

import pytest
from asked import KEY, request
from hosted import PROVIDERS, QUICK, batched, hosted
from hypothesis import given
from hypothesis import strategies as st
from llm_script import Script
from llm_server import serving
from raw_server import replying
from refusals import refused
from smallest import ARCHIVES, TOUCHES, UNTRACKED
from test_answers import chat, message
from test_model_search import network

from tacevo.cli.app import main
from tacevo.errors import ConfigError, TacevoError, TransportError
from tacevo.gate.extraction import first_look
from tacevo.llm.failures import KEY_REPEATED
from tacevo.llm.recording import RecordingLLM
from tacevo.records import Rejection
from tacevo.redaction import looks_like_key, repeats_secret, without_secrets
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys")
both = pytest.mark.parametrize("provider", PROVIDERS)

#: What users, and the pages of servers, write where a server wants no key.
WORDS = (
    *(
        "any",
        "x",
        "none",
        "None",
        "EMPTY",
        "dummy",
        "no-key",
        "not-needed",
        "sk-no-key-required",
        "lm-studio",
        "ollama",
    ),
    *("token-abc123", "sk-1234", "self", "forward", "in_channels", "your-api-key-here", "sk-xxxxxxxxxxxxxxxxxxxxxxxx"),
    *("0000000000000000", "sk-0000000000000000", "correct-horse-battery-staple"),
)

#: Keys shaped as those of providers, and as people make them.
KEYS = (
    *(KEY, "sk-proj-Ab3dEf6hIj9lMn2pQr5tUv8x", "gsk_9f8e7d6c5b4a39281706", "AIzaSyD4c3b2a1Z0y9x8W7v6U5t4S3"),
    *("hf_AbCdEfGhIjKlMnOpQrStUvWx", "3f0c9b1e-7a5d-4c2b-8e6f-1d0a9b8c7e6f", "a.b+c(d)[e]{f}^g$h|i?j*k1234567"),
    "eyJhbGciOiJIUzI1NiJ9.eyJzdWIiOiIxMjM0NTY3ODkwIn0.dozjgNryP4J3jVmNHl0w5N_XgL0n3I9P",
)


@pytest.mark.parametrize("word", WORDS)
def test_word_in_the_place_of_a_key_is_none(word: str) -> None:
    """It stands in any text, so it is looked for in none."""
    assert not looks_like_key(word)
    assert not repeats_secret(f"if {word}(x): return {word}", (word,))


@pytest.mark.parametrize("word", ["any", "x", "forward", "sk-no-key-required"])
@both
def test_answer_is_recorded_as_it_came(
    word: str, provider: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Every letter of it, in store and hand; and the name of its model."""
    monkeypatch.setenv(f"{provider.upper()}_API_KEY", word)
    text = f"if any({word} < 8 for side in x.shape): return self.forward(x)  # {word}"
    said = {"content": [{"type": "text", "text": text}]} if provider == "anthropic" else {"content": text}
    body = (message if provider == "anthropic" else chat)(model=f"a-{word}", **said)
    store = Store(tmp_path, "completions")
    with replying((200, body)) as server:
        ((_, answer),) = RecordingLLM(hosted(server.url, provider, patience=QUICK), store).complete([request("a")])
    assert (answer.text, answer.model, answer.stop_reason) == (text, f"a-{word}", "end_turn")
    ((_, again),) = RecordingLLM(None, store).complete([request("a")])
    assert again == answer


def divided(key: str) -> list[str]:
    """Write a key as a model, or a server, might."""
    middle = len(key) // 2
    halves = key[:middle], key[middle:]
    return [
        f"the key is {key}.",
        f"{key}more",
        f"more{key}",
        '("{}"\n    "{}")'.format(*halves),
        "'{}' + '{}'".format(*halves),
        "{}\n{}".format(*halves),
        " ".join(key),
        "\\\n".join(key[start : start + 5] for start in range(0, len(key), 5)),
    ]


@pytest.mark.parametrize("key", KEYS)
def test_key_is_found_however_it_is_divided(key: str) -> None:
    """Over lines, as parts of a string, letter by letter, within another word; and no answer without it has it."""
    assert looks_like_key(key)
    for text in divided(key):
        assert repeats_secret(text, ("x", key)), text
    for text in (key[:-1], key[1:], key.swapcase(), "", network({"messages": [1, 2]})):
        assert not repeats_secret(text, (key,)), text


@both
def test_answer_that_repeats_the_key_is_rejected_and_says_so(
    provider: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """It is asked once, and neither text nor key is recorded; it costs what it cost."""
    store = Store(tmp_path, "completions")
    for number, text in enumerate(divided(KEY)):
        said = {"content": [{"type": "text", "text": text}]} if provider == "anthropic" else {"content": text}
        with replying((200, (message if provider == "anthropic" else chat)(**said))) as server:
            asked = [request(f"a{number}")]
            ((_, answer),) = RecordingLLM(hosted(server.url, provider, patience=QUICK), store).complete(asked)
            assert len(server.bodies) == 1
        assert (answer.text, answer.stop_reason, answer.tokens) == ("", KEY_REPEATED, (10, 20))
        rejection = first_look(answer, limit=1000)
        assert isinstance(rejection, Rejection)
        assert "key" in rejection.detail
    assert not [path for path in tmp_path.rglob("*.json") if KEY in path.read_text()]
    assert KEY not in caplog.text


def test_model_that_is_called_as_the_key_is_rejected_too(tmp_path: Path) -> None:
    """A proxy may put the login where the model's name belongs."""
    store = Store(tmp_path, "completions")
    with replying((200, chat(model=f"m-{KEY}"))) as server:
        ((_, answer),) = RecordingLLM(hosted(server.url, "openai"), store).complete([request("a")])
    assert (answer.model, answer.stop_reason) == ("m-***", KEY_REPEATED)


def test_key_in_an_answer_of_a_batch_is_rejected(tmp_path: Path) -> None:
    """As one that comes directly."""
    with serving(Script(answer=lambda body: f"no idea, {KEY}")) as server:
        ((_, answer),) = batched(server.url, tmp_path).complete([request("a")])
    assert (answer.text, answer.stop_reason) == ("", KEY_REPEATED)


@both
@pytest.mark.parametrize("status", [200, 401, 500])
def test_key_is_in_no_message_wherever_the_server_puts_it(
    status: int, provider: str, caplog: pytest.LogCaptureFixture
) -> None:
    """In the middle, over two lines, and where the message is cut within it."""
    beginning = KEY[:16]
    for said in (f"no, {KEY}!", f"no, {KEY[:20]}\n{KEY[20:]}", f"{'x' * 475} {KEY}", f"{'x' * 482} {KEY}"):
        body = {"error": {"message": said}}
        expected: type[TacevoError] = ConfigError if status == 401 else TransportError
        with replying((status, body)) as server, refused(expected, got="***") as caught:
            list(hosted(server.url, provider, patience=QUICK).complete([request("a")]))
        for text in (str(caught.value), caplog.text):
            assert beginning not in re.sub(r"\s", "", text)


@both
def test_login_in_an_address_is_in_no_message(provider: str, caplog: pytest.LogCaptureFixture) -> None:
    """A user may write one into llm.base_url; a server that is not there, or refuses, is named without."""
    for status in (404, 500):
        with replying((status, {"error": {"message": "no"}})) as server:
            address = server.url.replace("http://", "http://me:hunter2secret@")
            with caplog.at_level(logging.WARNING), refused(TacevoError) as caught:
                list(hosted(address, provider, patience=QUICK).complete([request("a")]))
            assert "hunter2" not in str(caught.value)
    with refused(TransportError, got="127.0.0.1:1") as caught:
        list(hosted("http://me:hunter2secret@127.0.0.1:1", provider, patience=QUICK).complete([request("a")]))
    assert "hunter2" not in f"{caught.value}{caplog.text}"


@given(st.text(), st.sampled_from(KEYS), st.text())
def test_no_message_holds_a_key(before: str, key: str, after: str) -> None:
    """Whatever stands around it; and a text without one stays as it is."""
    told = without_secrets(f"{before}{key}{after}", (key, "x", "any"))
    assert key not in told
    assert "***" in told
    assert without_secrets(before, (key, "x", "any")) == before or key[:16] in re.sub(r"\s", "", before)


@pytest.mark.slow
def test_search_with_a_word_for_a_key_admits_what_holds_the_word(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The documentation's own example: the word is a name of Python."""
    monkeypatch.setenv("ANTHROPIC_API_KEY", "any")
    source = network({"messages": [1, 2]}).replace("        return", "        any(x.shape)\n        return")
    with serving(Script(answer=lambda body: source)) as server:
        tiny = [
            *TOUCHES,
            *ARCHIVES,
            UNTRACKED,
            "llm=anthropic",
            "search.generations=0",
            "search.initial=1",
            "run.dir=run",
        ]
        assert main(["search", *tiny, f"llm.base_url={server.url}"]) == 0
    (entry,) = Store(place / "cache", "completions").entries()
    assert entry.answer["text"] == source  # type: ignore[index,call-overload]
    assert '"reason"' not in (place / "run" / "ledger.jsonl").read_text()
