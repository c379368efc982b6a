"""Promise: the test server counts what it delivered and nothing else, and its faults follow from its seed."""

import json
import signal
import subprocess
import sys
import urllib.request
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from asked import request
from checkout import ROOT, SHARED
from hosted import batched, hosted
from llm_script import key_of
from llm_server import recorded_answers, serving
from refusals import refused

from tacevo.errors import ConfigError
from tacevo.evolution.development import LLM
from tacevo.records import Completion, Request

ANSWERS = SHARED / "llm_answers"
SERVER = ROOT / "tests" / "support" / "llm_server.py"

recorded_ones = pytest.mark.skipif(not ANSWERS.exists(), reason="the recorded answers are not here")


def recordings() -> dict[str, Any]:
    """Read the recorded answers by the names of their files."""
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(ANSWERS.glob("*.json"))}


def answers(llm: LLM, asked: list[Request]) -> list[Completion]:
    """Ask, and return the answers in the order of the requests."""
    given = dict(llm.complete(asked))
    return [given[position] for position in range(len(asked))]


def body(text: str) -> dict[str, object]:
    """Make a request's body."""
    return {"model": "m", "messages": [{"role": "user", "content": text}]}


def post(url: str, text: str) -> dict[str, object]:
    """Ask by hand."""
    data = json.dumps(body(text)).encode()
    with urllib.request.urlopen(urllib.request.Request(f"{url}/v1/messages", data=data, method="POST")) as answer:
        return dict(json.load(answer))


def test_only_delivered_answers_are_billed() -> None:
    """A failed try counts as tried; an answer that was cut off was not delivered."""
    with serving() as server:
        assert post(server.url, "a")["model"] == "m-dated"
        with pytest.raises(OSError, match="429"):
            post(server.url, "b [fault 429]")
        with pytest.raises(Exception, match=r"IncompleteRead|Connection reset"):
            post(server.url, "c [fault reset]")
        assert server.tried.total() == 3
        assert server.billed == {key_of(body("a")): 1}


@recorded_ones
@pytest.mark.usefixtures("keys")
@pytest.mark.parametrize("provider", ["anthropic", "openai", "batches"])
def test_every_recorded_answer_comes_whole_through_the_sdks(provider: str, tmp_path: Path) -> None:
    """Text and stop reason of all files, by each of the three APIs."""
    files = recordings()
    with serving(recorded_answers(ANSWERS, "")) as server:
        llm = batched(server.url, tmp_path) if provider == "batches" else hosted(server.url, provider)
        given = answers(llm, [request(name) for name in files])
        assert len(server.billed) == server.billed.total() == len(files)
    assert [(each.text, each.stop_reason) for each in given] == [
        (file["response"], file["stop_reason"]) for file in files.values()
    ]


@pytest.mark.usefixtures("keys")
def test_server_takes_the_part_of_a_model() -> None:
    """Started by hand with `--like`, it refuses, thinks and tells as that model does, and lacks all others."""
    command = [sys.executable, str(SERVER), "--like", "claude-haiku-5-5"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        llm = hosted(process.stdout.readline().strip())
        asked = replace(request("a"), model="claude-haiku-5-5")
        (completion,) = answers(llm, [asked])
        assert (completion.text, completion.dropped, completion.output_tokens) == ("a!", ("temperature",), 37)
        with refused(ConfigError, place="llm.thinking"):
            answers(llm, [replace(asked, settings=(("thinking", 1024),))])
        with refused(ConfigError, expected="a model that the server has (claude-haiku-5-5)"):
            answers(llm, [request("a")])
        process.send_signal(signal.SIGINT)


@recorded_ones
def test_server_is_started_by_hand() -> None:
    """Its first line is its address; it serves the directory, and Ctrl-C ends it quietly."""
    command = [sys.executable, str(SERVER), "--answers", str(ANSWERS), "--task", "grating"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        content = post(process.stdout.readline().strip(), "grating_000")["content"]
        process.send_signal(signal.SIGINT)
        _, complaints = process.communicate(timeout=60)
    assert content == [{"type": "text", "text": recordings()["grating_000"]["response"]}]
    assert (process.returncode, complaints) == (0, "")
