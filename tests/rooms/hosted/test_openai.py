"""Promise: a request reaches a chat-completions server whole, as that server spells it; what is missing is told."""

import subprocess
import sys

import pytest
from asked import KEY, request
from hosted import hosted
from llm_server import serving
from refusals import refused

from tacevo.errors import ConfigError
from tacevo.llm.openai import connect


@pytest.fixture(autouse=True)
def _no_key(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin without a key."""
    for name in ("OPENAI_API_KEY", "OPENAI_BASE_URL"):
        monkeypatch.delenv(name, raising=False)


def test_request_is_sent_whole() -> None:
    """The system prompt is the first turn, the draw number is the seed, and settings have this API's names."""
    asked = request("hi", draw=42, settings=(("stop_sequences", ("END",)), ("top_k", 40), ("top_p", 0.9)))
    with serving() as server:
        list(hosted(server.url, "openai").complete([asked]))
        (body,) = server.bodies
    assert body == {
        "model": "model-x",
        "messages": [{"role": "system", "content": "Be brief."}, {"role": "user", "content": "hi"}],
        "temperature": 0.65,
        "seed": 42,
        "max_tokens": 77,
        "stream": False,
        "stop": ["END"],
        "top_k": 40,
        "top_p": 0.9,
    }


def test_server_of_ones_own_wants_no_key(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a key in the environment something stands in for it; with one, it is sent."""
    with serving() as server:
        list(hosted(server.url, "openai").complete([request("a")]))
        monkeypatch.setenv("OPENAI_API_KEY", KEY)
        list(hosted(server.url, "openai").complete([request("b")]))
        assert server.logins == {"no-key", KEY}


def test_missing_key_for_the_makers_server_is_told_at_once() -> None:
    """Before anything is asked or made."""
    with refused(ConfigError, place="OPENAI_API_KEY", remedy="llm.base_url"):
        connect(None, 1)


def test_missing_extra_is_told_with_its_remedy() -> None:
    """Where the SDK is not installed, the message holds the command that installs it."""
    script = "import sys; sys.modules['openai'] = None; import tacevo.llm.openai"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "expected the openai SDK; got nothing; in the clone of tacevo: pip install -e '.[openai]'" in done.stderr
