"""Promise: a batch whose id is written down is paid for once, whatever happens to the run; each request is answered."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from asked import KEY, request
from hosted import batched
from llm_script import Script
from llm_server import LLMServer, serving
from refusals import refused

from tacevo.errors import ConfigError, StoreError, TransportError
from tacevo.llm import batches
from tacevo.llm.recording import RecordingLLM
from tacevo.records import Delivery, Request
from tacevo.storage.canonical import value_at
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys")

ASKED = [request(text) for text in ("a", "b", "c", "d", "e")]
ANSWERS = ["a!", "b!", "c!", "d!", "e!"]


@pytest.fixture
def server() -> Iterator[LLMServer]:
    """Return a server that behaves."""
    with serving(Script(polls=2)) as running:
        yield running


def recorded(url: str, root: Path, asked: list[Request] | None = None) -> list[str]:
    """Ask through the store; return the answers in the order of the requests."""
    wanted = ASKED if asked is None else asked
    answers = dict(RecordingLLM(batched(url, root), Store(root, "completions")).complete(wanted))
    return [answers[position].text for position in range(len(wanted))]


def records(root: Path) -> list[Path]:
    """List the records of batches."""
    return sorted((root / "batches").glob("*/*.json"))


def sizes(server: LLMServer) -> list[int]:
    """Count the requests of each batch."""
    return [len(batch.requests) for batch in server.batches]


def test_generation_is_one_batch_in_any_order(server: LLMServer, tmp_path: Path) -> None:
    """All requests go as one batch; its results come in another order, each finds its place, and nothing is left."""
    assert recorded(server.url, tmp_path) == ANSWERS
    (batch,) = server.batches
    shuffled = [json.loads(line)["custom_id"] for line in batch.lines]
    assert shuffled != [request["custom_id"] for request in batch.requests]
    assert server.bodies == []
    assert records(tmp_path) == []


def test_settings_and_delivery_are_those_of_the_request(server: LLMServer, tmp_path: Path) -> None:
    """Settings reach the server under their names, and the completion says that it came by a batch."""
    asked = request("a", settings=(("thinking_tokens", 2048), ("top_p", 0.9)))
    ((_, completion),) = batched(server.url, tmp_path).complete([asked])
    params = server.batches[0].requests[0]["params"]
    assert (params["temperature"], params["top_p"], params["max_tokens"]) == (0.65, 0.9, 77)
    assert params["thinking"] == {"type": "enabled", "budget_tokens": 2048}
    assert (completion.delivery, completion.model) == (Delivery.batch, "model-x-dated")


def test_unstored_answers_are_read_from_the_recorded_batch(server: LLMServer, tmp_path: Path) -> None:
    """Whatever portions later commands ask for, nothing is submitted again; the last stored answer frees the record."""
    list(batched(server.url, tmp_path).complete(ASKED))
    assert recorded(server.url, tmp_path, ASKED[1:3]) == ANSWERS[1:3]
    (record,) = records(tmp_path)
    assert KEY not in record.read_text(encoding="utf-8")
    assert "127.0.0.1" not in record.read_text(encoding="utf-8")
    assert recorded(server.url, tmp_path, [*ASKED, request("f")]) == [*ANSWERS, "f!"]
    assert sizes(server) == [5, 1]
    assert records(tmp_path) == []


@pytest.mark.parametrize("fault", ["errored", "expired"])
def test_unanswered_request_is_submitted_again_a_few_times(fault: str, server: LLMServer, tmp_path: Path) -> None:
    """The others are kept; after three batches the run says what failed."""
    answers = batched(server.url, tmp_path).complete([request("a"), request(f"b [fault {fault}]")])
    assert next(answers)[1].text == "a!"
    with refused(TransportError, got="1 of 2 requests failed after all tries"):
        next(answers)
    assert sizes(server) == [2, 1, 1]


@pytest.mark.parametrize(
    ("fault", "words"),
    [("canceled", "was canceled"), ("credit", "credit balance"), ("invalid", "this is not understood")],
)
def test_what_no_submission_can_mend_stops_the_run(fault: str, words: str, server: LLMServer, tmp_path: Path) -> None:
    """A cancelled batch, a refused payment, a refusal of more than one: submitted once, recorded never."""
    asked = [request("a"), *(request(f"{text} [fault {fault}]") for text in "bc")]
    with refused(ConfigError, got=words):
        recorded(server.url, tmp_path, asked)
    assert sizes(server) == [3]
    assert [value_at(entry.answer, ("text",)) for entry in Store(tmp_path, "completions").entries()] == ["a!"]


@pytest.mark.parametrize(("fault", "stop_reason"), [("too_long", "invalid_request"), ("filtered", "refusal")])
def test_request_that_can_never_be_answered_is_recorded(
    fault: str, stop_reason: str, server: LLMServer, tmp_path: Path
) -> None:
    """It stops no run, and is not submitted again."""
    answers = dict(batched(server.url, tmp_path).complete([request(f"a [fault {fault}]"), request("b")]))
    completion = answers[0]
    assert (completion.text, completion.stop_reason, completion.delivery) == ("", stop_reason, Delivery.batch)
    assert sizes(server) == [2]


def test_model_that_the_server_lacks_is_reported(tmp_path: Path) -> None:
    """The batch itself was accepted, so the address is not at fault."""
    with serving(Script(models=("model-y",))) as server, refused(ConfigError, place="llm.model", got="model-x"):
        recorded(server.url, tmp_path)


def test_refused_settings_are_dropped_and_recorded(tmp_path: Path) -> None:
    """The requests are submitted again without what the model refuses."""
    with serving(Script(refused=("temperature",))) as server:
        completions = [completion for _, completion in batched(server.url, tmp_path).complete(ASKED)]
        assert {completion.dropped for completion in completions} == {("temperature",)}
        assert sizes(server) == [5, 5]


@pytest.mark.parametrize("script", [Script(batch_faults=3, batch_status=status) for status in (429, 500, 529)])
def test_failed_calls_are_repeated(script: Script, tmp_path: Path) -> None:
    """Each call about a batch is repeated until it works, and the batch is submitted once."""
    with serving(script) as server:
        assert recorded(server.url, tmp_path) == ANSWERS
        assert sizes(server) == [5]


@pytest.mark.parametrize(("cut", "batches"), [("submitted", 1), ("created", 2), ("polled", 1), ("results", 1)])
def test_only_a_submission_without_an_answer_is_made_again(
    cut: str, batches: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The connection breaks in each window; where a batch may then exist twice, one warning says so."""
    with serving(Script(cut=cut)) as server:
        assert recorded(server.url, tmp_path) == ANSWERS
        assert len(server.batches) == batches
    assert caplog.text.count("it is billed twice") == (cut in {"submitted", "created"})


def test_results_without_an_answer_are_read_again_and_not_for_ever(tmp_path: Path) -> None:
    """What is paid for is not submitted again; a later command takes it."""
    with serving(Script(results="lacking")) as server:
        with refused(TransportError, remedy="repeat the same command"):
            recorded(server.url, tmp_path)
        assert server.results_read == 5
        server.script = Script()
        assert recorded(server.url, tmp_path) == ANSWERS
        assert sizes(server) == [5]


def test_answer_without_a_text_is_submitted_again_and_the_others_are_kept(tmp_path: Path) -> None:
    """A server that spoils one answer of a batch for good does not stop the run for good."""
    with serving(Script(results="textless")) as server:
        with refused(TransportError, got="1 of 5 requests failed"):
            recorded(server.url, tmp_path)
        assert (sizes(server), records(tmp_path)) == ([5, 1, 1], [])
        server.script = Script()
        assert recorded(server.url, tmp_path) == ANSWERS
        assert sizes(server) == [5, 1, 1, 1]


@pytest.mark.parametrize("lost", ["forgotten", "deleted"])
def test_batch_that_the_server_lost_is_never_replaced_silently(lost: str, server: LLMServer, tmp_path: Path) -> None:
    """This command and the next refuse, until the record that the message names is deleted."""
    list(batched(server.url, tmp_path).complete(ASKED))
    (record,) = records(tmp_path)
    if lost == "forgotten":
        server.batches[0].id = "another"
    else:
        server.batches[0].archived_at = "2026-01-01T00:00:00Z"
    for _ in range(2):
        with refused(ConfigError, place="batch msgbatch_0000", remedy=f"delete {record}"):
            recorded(server.url, tmp_path)
        assert sizes(server) == [5]
    record.unlink()
    assert recorded(server.url, tmp_path) == ANSWERS


def test_damaged_record_is_refused(server: LLMServer, tmp_path: Path) -> None:
    """Half a record is not a reason to submit again."""
    list(batched(server.url, tmp_path).complete(ASKED))
    (path,) = records(tmp_path)
    path.write_text(path.read_text(encoding="utf-8")[:40], encoding="utf-8")
    with refused(StoreError, place=str(path), remedy="delete it"):
        recorded(server.url, tmp_path)
    assert sizes(server) == [5]


def test_records_of_another_server_are_left_alone(server: LLMServer, tmp_path: Path) -> None:
    """Its ids mean nothing here."""
    list(batched(server.url, tmp_path).complete(ASKED))
    with serving() as other:
        assert recorded(other.url, tmp_path) == ANSWERS
    assert len(records(tmp_path)) == 1


def test_large_generations_are_divided(server: LLMServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The server limits a batch's size."""
    monkeypatch.setattr(batches, "MOST_REQUESTS", 3)
    assert recorded(server.url, tmp_path) == ANSWERS
    assert sizes(server) == [3, 2]


_RUN = """
import sys
from pathlib import Path
from test_batches import recorded
print(recorded(sys.argv[1], Path(sys.argv[2])))
"""


@pytest.mark.parametrize("stall", ["polled", pytest.param("results", marks=pytest.mark.slow)])
def test_killed_run_submits_nothing_twice(stall: str, tmp_path: Path) -> None:
    """SIGKILL while it waits for the batch, and while it reads."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with serving(Script(stall=stall)) as server:
        child = subprocess.Popen([sys.executable, "-c", _RUN, server.url, str(tmp_path)], env=environment)
        assert server.stalled.wait(timeout=60)
        child.send_signal(signal.SIGKILL)
        assert child.wait() == -signal.SIGKILL
        assert recorded(server.url, tmp_path) == ANSWERS
        assert sizes(server) == [5]
        assert set(server.billed.values()) == {1}
