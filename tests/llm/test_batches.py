"""Promise: a batch is submitted once and paid for once, whatever happens to the run; every request gets its answer."""

import itertools
import json
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hosted import KEY, batched, request
from llm_script import Script
from llm_server import LLMServer, serving

from tacevo.errors import ConfigError, LLMError, StoreError, TransportError
from tacevo.llm.anthropic import body_of, connect_batches
from tacevo.llm.batch_records import BatchRecord, BatchRecords
from tacevo.llm.recording import RecordingLLM
from tacevo.records import Delivery, Request, to_json
from tacevo.storage.canonical import content_hash
from tacevo.storage.store import Store

ASKED = [request(text) for text in ("a", "b", "c", "d", "e")]


@pytest.fixture(autouse=True)
def _key(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the key where the SDK looks for it."""
    monkeypatch.setenv("ANTHROPIC_API_KEY", KEY)


def recorded(url: str, root: Path, asked: list[Request] | None = None) -> list[str]:
    """Ask through the store, and give the answers in the order of the requests."""
    wanted = ASKED if asked is None else asked
    answers = dict(RecordingLLM(batched(url, root), Store(root, "completions")).complete(wanted))
    return [answers[position].text for position in range(len(wanted))]


def records(root: Path) -> list[Path]:
    """List what is remembered of batches."""
    return sorted((root / "batches").glob("*"))


@pytest.fixture
def server() -> Iterator[LLMServer]:
    """Give a server that behaves."""
    with serving(Script(polls=2)) as running:
        yield running


def test_generation_is_one_batch_in_any_order(server: LLMServer, tmp_path: Path) -> None:
    """All requests go as one batch; its results come in another order, and each finds its place."""
    assert recorded(server.url, tmp_path) == ["a!", "b!", "c!", "d!", "e!"]
    (batch,) = server.batches
    shuffled = [json.loads(line)["custom_id"] for line in batch.lines]
    assert shuffled != [request["custom_id"] for request in batch.requests]
    assert server.bodies == []


def test_request_in_a_batch_is_that_of_the_messages_api(server: LLMServer, tmp_path: Path) -> None:
    """Settings of every kind reach the server under their names."""
    list(batched(server.url, tmp_path).complete([request("a", settings=(("thinking_tokens", 2048), ("top_p", 0.9)))]))
    params = server.batches[0].requests[0]["params"]
    assert (params["temperature"], params["top_p"], params["max_tokens"]) == (0.65, 0.9, 77)
    assert params["thinking"] == {"type": "enabled", "budget_tokens": 2048}


def test_completion_says_that_it_came_by_a_batch(server: LLMServer, tmp_path: Path) -> None:
    """Its price follows from that."""
    ((_, completion),) = batched(server.url, tmp_path).complete(ASKED[:1])
    assert completion.delivery is Delivery.batch
    assert (completion.model, completion.output_tokens) == ("model-x-dated", 7)


def test_record_stands_until_the_answers_are_stored(server: LLMServer, tmp_path: Path) -> None:
    """Answers that were read but not stored are taken from the same batch again; stored ones free the record."""
    unstored = batched(server.url, tmp_path)
    assert len(list(unstored.complete(ASKED))) == 5
    assert recorded(server.url, tmp_path) == ["a!", "b!", "c!", "d!", "e!"]
    assert len(server.batches) == 1
    assert len(records(tmp_path)) == 1
    recorded(server.url, tmp_path, [request("f")])
    assert len(server.batches) == 2
    assert len(records(tmp_path)) == 1


def test_part_of_a_batch_is_taken_from_it(server: LLMServer, tmp_path: Path) -> None:
    """A run that asks in other portions than the one before, as under a budget, submits nothing again."""
    list(batched(server.url, tmp_path).complete(ASKED))
    assert recorded(server.url, tmp_path, ASKED[1:3]) == ["b!", "c!"]
    assert recorded(server.url, tmp_path, [*ASKED, request("f")]) == ["a!", "b!", "c!", "d!", "e!", "f!"]
    assert [len(batch.requests) for batch in server.batches] == [5, 1]


@pytest.mark.parametrize("fault", ["errored", "expired"])
def test_unanswered_request_is_submitted_again_a_few_times(fault: str, server: LLMServer, tmp_path: Path) -> None:
    """The others are kept; after three batches the run says what failed."""
    answers = batched(server.url, tmp_path).complete([request("a"), request(f"b [fault {fault}]")])
    assert next(answers)[1].text == "a!"
    with pytest.raises(TransportError, match="1 of 2 requests failed after all tries"):
        next(answers)
    assert [len(batch.requests) for batch in server.batches] == [2, 1, 1]


def test_canceled_request_is_reported_and_submitted_anew_by_the_next_command(server: LLMServer, tmp_path: Path) -> None:
    """Somebody wanted it to end, so this run submits nothing more."""
    for number in (1, 2):
        with pytest.raises(TransportError, match="canceled; give the same command again"):
            list(batched(server.url, tmp_path).complete([request("a [fault canceled]")]))
        assert len(server.batches) == number


@pytest.mark.parametrize(("fault", "stop_reason"), [("too_long", "invalid_request"), ("filtered", "refusal")])
def test_request_that_can_never_be_answered_is_recorded(
    fault: str, stop_reason: str, server: LLMServer, tmp_path: Path
) -> None:
    """It stops no run, and is not submitted again."""
    answers = dict(batched(server.url, tmp_path).complete([request(f"a [fault {fault}]"), request("b")]))
    completion = answers[0]
    assert (completion.text, completion.stop_reason, completion.delivery) == ("", stop_reason, Delivery.batch)
    assert len(server.batches) == 1


def test_refusal_of_all_but_one_is_recorded_for_none(server: LLMServer, tmp_path: Path) -> None:
    """A batch has no order, so an answer in it does not say that the account stood when another was refused."""
    asked = [request(text) for text in ("a", "b [fault invalid]", "c [fault invalid]")]
    with pytest.raises(ConfigError, match="this is not understood"):
        recorded(server.url, tmp_path, asked)
    assert [entry.answer["text"] for entry in Store(tmp_path, "completions").entries()] == ["a!"]


@pytest.mark.parametrize("results", ["lacking", "unreadable"])
def test_results_without_an_answer_are_read_again_with_pauses_and_not_for_ever(results: str, tmp_path: Path) -> None:
    """What is paid for is neither submitted again nor waited for without end; a later command takes it."""
    with serving(Script(results=results)) as server:
        with pytest.raises(TransportError, match=r"lack 1 answer,.*give the same command again"):
            recorded(server.url, tmp_path)
        assert server.results_read == 5
        server.script = Script()
        assert recorded(server.url, tmp_path) == ["a!", "b!", "c!", "d!", "e!"]
        assert len(server.batches) == 1


def test_interruption_ends_the_reading_of_results_without_an_answer(tmp_path: Path) -> None:
    """The pauses between the readings see it."""
    stop = threading.Event()
    with serving(Script(results="lacking")) as server:
        threading.Timer(0.2, stop.set).start()
        with pytest.raises(LLMError, match="interrupted"):
            list(batched(server.url, tmp_path, stop=stop, tries=10**9).complete(ASKED))


def test_broken_results_count_no_failure_twice(tmp_path: Path) -> None:
    """A request that the server failed on stands in both readings, but was submitted once."""
    with serving(Script(cut="results")) as server:
        asked = [request(f"{number} [fault errored]") for number in range(9)]
        with pytest.raises(TransportError, match="9 of 9 requests failed after all tries"):
            list(batched(server.url, tmp_path).complete(asked))
        assert [len(batch.requests) for batch in server.batches] == [9, 9, 9]


def test_refused_payment_stops_the_run(server: LLMServer, tmp_path: Path) -> None:
    """It is the user's to mend."""
    with pytest.raises(ConfigError, match="credit balance"):
        list(batched(server.url, tmp_path).complete([request("a [fault credit]")]))


def test_model_that_the_server_lacks_is_told_with_the_names_to_use(tmp_path: Path) -> None:
    """The batch itself was accepted, so the address is not at fault."""
    words = r"no model model-x; set llm\.model to one that it lists \(model-y\)\. It says: 404: model: model-x"
    with serving(Script(models=("model-y",))) as server, pytest.raises(ConfigError, match=words) as refused:
        list(batched(server.url, tmp_path).complete(ASKED))
    assert "llm.base_url" not in str(refused.value)


def test_refused_settings_are_dropped_and_recorded(tmp_path: Path) -> None:
    """The requests are submitted again without what the model refuses, and the refused ones cost nothing."""
    with serving(Script(refused=("temperature",))) as server:
        completions = [completion for _, completion in batched(server.url, tmp_path).complete(ASKED)]
        assert {completion.dropped for completion in completions} == {("temperature",)}
        assert [len(batch.requests) for batch in server.batches] == [5, 5]


@pytest.mark.parametrize("status", [429, 500, 529])
def test_failed_calls_are_retried(status: int, tmp_path: Path) -> None:
    """Each call about a batch is repeated until it works, and the batch is submitted once."""
    with serving(Script(batch_faults=3, batch_status=status)) as server:
        assert recorded(server.url, tmp_path) == ["a!", "b!", "c!", "d!", "e!"]
        assert len(server.batches) == 1


@pytest.mark.parametrize("cut", ["submitted", "created", "polled", "results"])
def test_lost_connection_submits_nothing_twice(cut: str, tmp_path: Path) -> None:
    """Wherever the connection breaks: where the batch exists it is found, and only where it does not, submitted."""
    with serving(Script(cut=cut)) as server:
        assert recorded(server.url, tmp_path) == ["a!", "b!", "c!", "d!", "e!"]
        assert len(server.batches) == 1
        assert set(server.billed.values()) == {1}


def test_someone_elses_batch_is_not_taken_for_ours(server: LLMServer, tmp_path: Path) -> None:
    """A batch of the same size that another program submitted meanwhile is recognised as foreign by its names."""
    _cut_off_a_submission(server.url, tmp_path)
    _submit_elsewhere(server.url)
    assert recorded(server.url, tmp_path) == ["a!", "b!", "c!", "d!", "e!"]
    assert [len(batch.requests) for batch in server.batches] == [5, 5]
    assert server.batches[0].requests[0]["custom_id"] == "other0"


def test_candidate_whose_results_are_deleted_is_never_replaced_silently(server: LLMServer, tmp_path: Path) -> None:
    """Nothing in it can be recognised, so it may be ours, and paid for: this command and the next refuse."""
    _cut_off_a_submission(server.url, tmp_path)
    _submit_elsewhere(server.url)
    server.batches[0].archived_at = "2026-01-01T00:00:00Z"
    for _ in range(2):
        with pytest.raises(ConfigError, match=r"has deleted its results.*delete .*\.json to submit, and to pay for"):
            recorded(server.url, tmp_path)
        assert len(server.batches) == 1
    records(tmp_path)[0].unlink()
    assert recorded(server.url, tmp_path) == ["a!", "b!", "c!", "d!", "e!"]


def test_submission_that_left_no_batch_is_told_before_it_is_made_again(
    server: LLMServer, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Another key or workspace may hold it, and this one cannot see that: the user hears of it."""
    _cut_off_a_submission(server.url, tmp_path)
    with caplog.at_level(logging.WARNING):
        assert recorded(server.url, tmp_path) == ["a!", "b!", "c!", "d!", "e!"]
    (said,) = caplog.messages
    assert said.startswith("llm=anthropic: no batch found for 5 requests whose submission was cut off")
    assert "another key or workspace" in said
    caplog.clear()
    recorded(server.url, tmp_path, [request("f")])
    assert caplog.messages == []


def _cut_off_a_submission(url: str, root: Path) -> tuple[str, ...]:
    """Leave the record of a run that was killed before it knew its batch's id; give the keys of the requests."""
    store = Store(root, "completions")
    keys = tuple(store.key(to_json(asked)) for asked in ASKED)
    with connect_batches(url) as client:
        own = BatchRecords(root / "batches", content_hash(str(client.base_url)))
    own.write(BatchRecord(server=own.server, keys=keys, requests=len(keys), dropped=(), known=()))
    return keys


def _submit_elsewhere(url: str) -> None:
    params = {"model": "m", "max_tokens": 1, "messages": [{"role": "user", "content": "x"}]}
    with connect_batches(url) as client:
        client.messages.batches.create(requests=[{"custom_id": f"other{n}", "params": params} for n in range(5)])  # type: ignore[typeddict-item]


def test_interruption_leaves_the_batch_running(tmp_path: Path) -> None:
    """Waiting ends at once; the next run takes the answers of the same batch."""
    stop = threading.Event()
    with serving(Script(polls=20)) as server:
        threading.Timer(0.1, stop.set).start()
        with pytest.raises(LLMError, match="submitted batches go on"):
            list(batched(server.url, tmp_path, stop=stop).complete(ASKED))
        assert recorded(server.url, tmp_path) == ["a!", "b!", "c!", "d!", "e!"]
        assert [batch.canceled for batch in server.batches] == [False]


def test_unknown_batch_is_not_paid_for_twice_silently(server: LLMServer, tmp_path: Path) -> None:
    """Another key sees other batches: the message names the record, and nothing is submitted."""
    list(batched(server.url, tmp_path).complete(ASKED))
    server.batches.clear()
    with pytest.raises(
        ConfigError, match=r"batch msgbatch_0000 holds 5 requests, perhaps paid for, but .*404.*delete .*\.json"
    ):
        recorded(server.url, tmp_path)
    assert server.batches == []


def test_candidate_that_goes_is_never_replaced_silently(tmp_path: Path) -> None:
    """It may have been ours: this command and the next refuse, until the record that the message names is deleted."""
    never = Script(cut="created", polls=10**9)
    with serving(never) as server:
        goes = threading.Thread(target=_forget_when_looked_at, args=(server,))
        goes.start()
        for _ in range(2):
            with pytest.raises(ConfigError, match=r"404.*delete .*\.json to submit, and to pay for, them anew"):
                recorded(server.url, tmp_path)
            assert server.batches == []
        goes.join()
        records(tmp_path)[0].unlink()
        assert recorded(server.url, tmp_path) == ["a!", "b!", "c!", "d!", "e!"]


def test_foreign_candidate_that_goes_stops_no_run(tmp_path: Path) -> None:
    """Where another candidate holds our names, the one that went was not ours."""
    with serving(Script(polls=10**9)) as server:
        keys = _cut_off_a_submission(server.url, tmp_path)
        _submit_elsewhere(server.url)
        ours: Any = [{"custom_id": key, "params": body_of(asked, ())} for key, asked in zip(keys, ASKED, strict=True)]
        with connect_batches(server.url) as client:
            client.messages.batches.create(requests=ours)
        goes = threading.Thread(target=_forget_when_looked_at, args=(server,))
        goes.start()
        assert recorded(server.url, tmp_path) == ["a!", "b!", "c!", "d!", "e!"]
        goes.join()
        assert set(server.billed.values()) == {1}


def _forget_when_looked_at(server: LLMServer) -> None:
    """Let a server forget its oldest batch while somebody waits for it; those that remain end."""
    while not server.batches or not server.batches[0].polls:
        time.sleep(0.005)
    del server.batches[0]
    server.script = replace(server.script, polls=0)


def test_damaged_record_is_named_and_refused(server: LLMServer, tmp_path: Path) -> None:
    """Half a record is no reason to submit again."""
    list(batched(server.url, tmp_path).complete(ASKED))
    (path,) = records(tmp_path)
    path.write_text(path.read_text(encoding="utf-8")[:40], encoding="utf-8")
    with pytest.raises(StoreError, match=rf"{path.name} is no record of a batch"):
        recorded(server.url, tmp_path)
    assert len(server.batches) == 1


def test_records_of_another_server_are_left_alone(tmp_path: Path) -> None:
    """Its ids mean nothing here."""
    with serving() as first, serving() as second:
        list(batched(first.url, tmp_path).complete(ASKED))
        list(batched(second.url, tmp_path).complete(ASKED))
        assert (len(first.batches), len(second.batches), len(records(tmp_path))) == (1, 1, 2)


def test_record_holds_no_key_and_no_address(server: LLMServer, tmp_path: Path) -> None:
    """A store is there to be shared."""
    ((_, echoed),) = batched(server.url, tmp_path).complete([request("a [fault echo]")])
    assert echoed.text == "you are ***"
    (path,) = records(tmp_path)
    assert KEY not in path.read_text(encoding="utf-8")
    assert "127.0.0.1" not in path.read_text(encoding="utf-8")


def test_large_generations_are_divided(server: LLMServer, tmp_path: Path) -> None:
    """The server limits a batch's size, and models are not mixed."""
    asked = [request(f"q{number}") for number in range(5_003)]
    assert len(list(batched(server.url, tmp_path).complete(asked))) == 5_003
    assert [len(batch.requests) for batch in server.batches] == [5_000, 3]


_RUN = """
import sys
from pathlib import Path
from test_batches import recorded
print(recorded(sys.argv[1], Path(sys.argv[2])))
"""


@pytest.mark.parametrize("stall", ["submitted", "created", "polled", "results"])
def test_killed_run_submits_nothing_twice(stall: str, tmp_path: Path) -> None:
    """SIGKILL in each window: before the batch exists, before its id is written down, while waiting, while reading."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "ANTHROPIC_API_KEY": KEY}
    with serving(Script(stall=stall)) as server:
        command = [sys.executable, "-c", _RUN, server.url, str(tmp_path)]
        child = subprocess.Popen(command, env=environment)
        assert server.stalled.wait(timeout=60)
        child.send_signal(signal.SIGKILL)
        assert child.wait() == -signal.SIGKILL
        assert recorded(server.url, tmp_path) == ["a!", "b!", "c!", "d!", "e!"]
        assert len(server.batches) == 1
        assert set(server.billed.values()) == {1}
        assert list(itertools.islice(server.bodies, 1)) == []
