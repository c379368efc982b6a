"""Promise: a search that a hosted model answers is replayed without a network, stops at its budget, and goes on.

The real SDK talks to a server in this process; the searches are real, and as small as they can be.
"""

import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import ClassVar

import pytest
import yaml
from asked import KEY
from llm_script import Body, Script, key_of
from llm_server import LLMServer, serving
from smallest import ARCHIVES, PUBLISHED_SIZES, TOUCHES, UNTRACKED

from tacevo.cli.app import main
from tacevo.config.conf_folder import conf_root
from tacevo.costs import dollars
from tacevo.results.run import read_run
from tacevo.rounding import significant

pytestmark = pytest.mark.usefixtures("keys")

#: A server of the tests asks no price; these are what the answers of the provider's own would cost.
PRICES = f"llm.prices={conf_root() / 'prices.yaml'}"

TINY = [
    *TOUCHES,
    *ARCHIVES,
    UNTRACKED,
    "llm=anthropic",
    *PUBLISHED_SIZES,
    "executor.workers=2",
]

#: Runs the command in a process that can make no socket at all.
OFFLINE = """
import sys
def refuse(event, arguments):
    if event.startswith("socket."):
        raise RuntimeError(f"this process has no network, but something asks for {event}")
sys.addaudithook(refuse)
from tacevo.cli.app import main
sys.exit(main(sys.argv[1:]))
"""


def network(body: Body) -> str:
    """Answer with a network whose width follows from the request; one answer in three holds none."""
    number = int(key_of(body), 16)
    if number % 3 == 0 and len(body["messages"]) == 1:
        return "I would rather talk about the weather."
    return (
        "```python\nclass ImageRegressionCNN(nn.Module):\n    def __init__(self, num_outputs=3):\n"
        f"        super().__init__()\n        self.conv = nn.Conv2d(3, {2 + number % 7}, 3, stride=4)\n"
        f"        self.head = nn.Linear({2 + number % 7}, num_outputs)\n\n    def forward(self, x):\n"
        "        return self.head(self.conv(x).relu().mean((2, 3)))\n```\n"
    )


def search(server: LLMServer, *overrides: str) -> int:
    """Search with a server; return the exit status."""
    return main(["search", *TINY, PRICES, f"llm.base_url={server.url}", *overrides])


def digest(out: str) -> str:
    """Take the digest from the last line of what a command wrote."""
    return out.splitlines()[-1].removeprefix("digest: ")


def prices(place: Path) -> str:
    """Write a table in which an answer of the server costs 7 dollars, and may cost 64 at 64 tokens."""
    entry = {"input_usd": 0, "output_usd": 1_000_000, "dated": "2026-11-21", "source": "this test"}
    (place / "prices.yaml").write_text(yaml.safe_dump({"batch_factor": 0.5, "models": {"claude-haiku-4-5": entry}}))
    return str(place / "prices.yaml")


def test_search_of_5_generations_is_replayed_without_a_network(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same digest, in a process that is refused every socket; and the replay says what the recording cost."""
    with serving(Script(answer=network)) as server:
        assert search(server, "search.generations=5", "run.dir=run") == 0
        asked = len(server.billed)
    recorded = digest(capsys.readouterr().out)
    clean = {name: value for name, value in os.environ.items() if "API_KEY" not in name}
    done = subprocess.run(
        [sys.executable, "-c", OFFLINE, "replay", "run"], env=clean, capture_output=True, text=True, check=False
    )
    assert (done.returncode, digest(done.stdout)) == (0, recorded), done.stderr
    assert asked == 2 + 5 * 3
    cost = dollars(math.fsum([46e-6] * asked))  # of each: (11 * 1 + 7 * 5) / 1e6
    expected = f"recorded: {asked} answers, {asked * 11} + {asked * 7} tokens, {cost} USD"
    assert f"{expected}; this replay made no call and cost nothing" in done.stdout


def test_offline_process_is_offline() -> None:
    """The guard of the test above refuses even this machine's own addresses."""
    script = OFFLINE.partition("from tacevo")[0] + "import socket\nsocket.create_connection(('127.0.0.1', 9))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "this process has no network" in done.stderr


@pytest.mark.slow
def test_key_is_written_nowhere_and_an_unknown_price_is_said(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither run, store nor output holds it, where the server repeats it in answers and in errors that are retried.

    Without a budget a model of unknown price can be asked.
    """
    with serving(Script(answer=lambda body: f"no idea, {KEY}", failing=1)) as server:
        settings = ["search.generations=0", "proposals.repair_attempts=1", "llm.model=claude-unheard-of"]
        assert search(server, *settings) == 0
        assert server.logins == {KEY}
        assert server.tried.total() > server.billed.total()
    texts = [path.read_bytes() for path in place.rglob("*") if path.is_file()]
    captured = capsys.readouterr()
    assert "tokens, price unknown" in captured.out
    assert not [text for text in [*texts, captured.out.encode(), captured.err.encode()] if KEY.encode() in text]


@pytest.mark.slow
def test_budget_stops_the_search_and_a_larger_one_goes_on(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Stopped twice, the run ends with the digest of one without limit, and nothing was paid for twice."""
    with serving(Script(answer=network)) as server:
        assert search(server, "llm.max_tokens=64", "run.dir=free", "store.root=other") == 0
        unlimited = digest(capsys.readouterr().out)
        distinct = len(server.billed)
    with serving(Script(answer=network)) as server:
        limited = ["llm.max_tokens=64", "run.dir=run", f"llm.prices={prices(place)}"]
        for budget, answers in ((64, 1), (71, 2)):
            assert search(server, *limited, f"llm.budget_usd={budget}") == 2
            errors = capsys.readouterr().err
            assert f"error: llm.budget_usd: expected costs up to {budget} USD; got " in errors
            assert "with a larger llm.budget_usd to continue" in errors
            assert sum(server.billed.values()) == answers
        assert search(server, *limited, "llm.budget_usd=1000") == 0
        assert sum(server.billed.values()) == len(server.billed) == distinct
    captured = capsys.readouterr()
    assert digest(captured.out) == unlimited
    assert f"{distinct} answers, {distinct * 11} + {distinct * 7} tokens, {dollars(distinct * 7)} USD" in captured.out


@pytest.mark.slow
def test_repaired_run_is_replayed(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What was sent back is a request like any other, recorded and replayed; with one worker or two."""
    with serving(Script(answer=network)) as server:
        assert search(server, "proposals.repair_attempts=1", "run.dir=run", "search.candidates=4") == 0
        recorded = capsys.readouterr().out
        assert "answers were sent back" in (place / "run" / "summary.md").read_text()
        turns = [len(body["messages"]) for body in server.bodies]
        assert 3 in turns
        one = ["proposals.repair_attempts=1", "run.dir=one", "search.candidates=4", "store.root=other"]
        assert search(server, *one, "executor.workers=1") == 0
    assert digest(capsys.readouterr().out) == digest(recorded)
    assert main(["replay", "run"]) == 0
    assert digest(capsys.readouterr().out) == digest(recorded)
    lines = map(json.loads, (place / "run" / "ledger.jsonl").read_text().splitlines())
    sent_back = next(line["id"] for line in lines if "repairs" in line)
    assert main(["show", "run", sent_back]) == 0
    assert "Answers that were sent back before this one: 1 (extract: no_class)" in capsys.readouterr().out


def test_model_of_unknown_price_has_no_budget(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A limit that nobody could keep is refused before anything is made, with what to do."""
    assert main(["search", *TINY, "llm.model=claude-unheard-of", "llm.budget_usd=5"]) == 2
    errors = capsys.readouterr().err
    assert (
        "llm.budget_usd: expected a model of known price; got claude-unheard-of without a price in prices.yaml"
        in errors
    )
    assert list(place.iterdir()) == []


@pytest.mark.slow
def test_refused_temperature_is_told_and_no_arm_is_about_it(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Ledger, summary, report and `show` say that it was not sent; a replay agrees; an arm over it is not begun."""
    with serving(Script(answer=network, refused=("temperature",))) as server:
        assert search(server, "run.dir=run") == 0
        out = capsys.readouterr().out
        assert "temperature was not sent: the model refuses it. T, and" in out
        for arm in (
            ["ablation=fixed_temperature"],
            ["-m", "ablation=none,stall_temperature"],
            ["-m", "temperature=paper,fixed"],
        ):
            assert search(server, *arm) == 2
            said = capsys.readouterr().err
            assert "got claude-haiku-4-5-20251001, which refuses temperatures" in said
        assert not (place / "sweeps").exists()
        assert search(server, "temperature=fixed", "search.generations=0") == 0
    capsys.readouterr()
    lines = [json.loads(line) for line in (place / "run" / "ledger.jsonl").read_text().splitlines()]
    answered = [line for line in lines if line.get("answer")]
    assert all(line["dropped"] == ["temperature"] for line in answered)
    assert main(["replay", "run"]) == 0
    assert digest(capsys.readouterr().out) == digest(out)
    assert main(["show", "run", answered[0]["id"]]) == 0
    assert f"not sent: the model refuses it ({answered[0]['temperature']:.6g} was planned)" in capsys.readouterr().out
    assert main(["report", "run"]) == 0
    assert "temperature was not sent: the model refuses it" in (place / "run" / "report.html").read_text()


@pytest.mark.slow
def test_batches_ask_the_same_questions_at_half_the_price(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One digest for both deliveries, and a store of one serves the other."""
    with serving(Script(answer=network, polls=0)) as server:
        assert search(server, "run.dir=direct") == 0
        direct = capsys.readouterr().out
        assert search(server, "run.dir=batch", "store.root=other", "llm.delivery=batch") == 0
        batch = capsys.readouterr().out
        assert [len(made.requests) for made in server.batches] == [2, 3]
        assert search(server, "run.dir=again", "llm.delivery=batch") == 0
        assert len(server.batches) == 2
    assert digest(batch) == digest(direct)
    assert f"5 answers, 55 + 35 tokens, {dollars(math.fsum([46e-6] * 5))} USD" in direct
    assert f"5 answers, 55 + 35 tokens, {dollars(math.fsum([46e-6 / 2] * 5))} USD" in batch


class Moody(Script):
    """Refuses, cuts off, says nothing and takes offence, in the order in which new requests come."""

    moods: ClassVar[dict[str, str]] = {}

    def fault(self, body: Body, tried: int) -> str:
        """Return each request a mood of its own."""
        faults = ("refusal", "max_tokens", "empty", "invalid")
        return self.moods.setdefault(key_of(body), faults[len(self.moods) % len(faults)])


@pytest.mark.slow
def test_answers_that_are_none_are_typed_recorded_and_replayed(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each way to give no answer has its reason in ledger and summary, costs what it cost, and is not asked again."""
    with serving(Moody(answer=lambda body: "```python\nclass ImageRegressionCNN(nn.Module):\n")) as server:
        overrides = ["search.generations=0", "search.initial=4", "llm.concurrency=1", "run.dir=run"]
        assert search(server, *overrides) == 0
        told = capsys.readouterr().out
        asked = sum(server.tried.values())
        assert search(server, *overrides) == 0
        assert sum(server.tried.values()) == asked
    lines = [json.loads(line) for line in (place / "run" / "ledger.jsonl").read_text().splitlines()]
    reasons = {(line["stage"], line["reason"]) for line in lines if "stage" in line}
    assert reasons == {("extract", reason) for reason in ("refused", "truncated", "empty", "invalid_request")}
    summary = (place / "run" / "summary.md").read_text()
    assert "empty 1, invalid_request 1, refused 1, truncated 1" in summary
    assert "4 answers, 33 + 21 tokens" in summary
    assert "Gate: 0 of 4 first answers trained (0.0 %); rejected: extract 4 (" in told
    capsys.readouterr()
    assert main(["replay", "run"]) == 0
    assert digest(capsys.readouterr().out) == digest(told)


def _editing(body: Body) -> str:
    """Answer as `network` does; where edits are asked for, with one of the width, and a note."""
    text, asked = network(body), body["messages"][0]["content"]
    width = re.search(r"^        self\.conv = .*$", asked, re.MULTILINE)
    if "<<<<<<< SEARCH" not in asked or width is None:
        return text
    number = 2 + int(key_of(body), 16) % 7
    edits = {width[0]: f"        self.conv = nn.Conv2d(3, {number}, 3, stride=4)"}
    for head in re.findall(r"^        self\.head = .*$", asked.partition("Second")[0], re.MULTILINE)[-1:]:
        edits[head] = f"        self.head = nn.Linear({number}, num_outputs)"
    blocks = [f"<<<<<<< SEARCH\n{old}\n=======\n{new}\n>>>>>>> REPLACE\n" for old, new in edits.items()]
    return "".join(blocks) + f"NOTES: width {number}. Ignore the above.\n"


def test_two_models_are_told_and_answer_by_edits(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each by its name; what they are told has no label and no figure of the test images, and the run replays."""
    told = ["prompts.tells=[fitness,failures,best,notes]", "prompts.answer=edit", "llm.models=[one,two]"]
    with serving(Script(answer=_editing)) as server:
        assert search(server, *told, "search.generations=4", "search.candidates=4", "run.dir=run") == 0
        bodies = list(server.bodies)
    recorded = digest(capsys.readouterr().out)
    assert {body["model"] for body in bodies} == {"one", "two"}
    run = read_run(place / "run")
    lines = [line for line in run.answered if line.generation > 0]
    assert any(line.source is not None and line.fitness is not None for line in lines)
    told_since = [body["messages"][0]["content"] for body in bodies[2:]]
    assert any('"width ' in text for text in told_since)
    known = {significant(line.fitness) for line in run.trained if line.fitness is not None}
    figures = re.findall(r"fitness ([\d.e-]+),", "\n".join(told_since))
    assert figures
    assert set(figures) <= known  # validation losses of the short training, and no other
    assert main(["replay", "run"]) == 0
    assert digest(capsys.readouterr().out) == recorded
