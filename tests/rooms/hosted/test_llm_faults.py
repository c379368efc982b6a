"""Promise: through any storm each request is answered, stored and paid for once; a killed run asks nothing twice.

The real SDKs, the real store and a real server, which fails three tries of ten.
"""

import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest
from asked import request
from hosted import hosted, stored
from llm_script import Script, text_of
from llm_server import LLMServer, serving

from tacevo.llm.recording import RecordingLLM
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys")


def ask(url: str, root: Path, count: int, provider: str = "anthropic") -> Counter[str]:
    """Ask so many different requests, each twice, through the store; count the answers' texts."""
    asked = [request(f"question {number}") for number in range(count)] * 2
    llm = RecordingLLM(hosted(url, provider, concurrency=64), Store(root, "completions"))
    return Counter(completion.text for _, completion in llm.complete(asked))


def expect_each_once(server: LLMServer, root: Path, answers: Counter[str], count: int) -> None:
    """Compare answers, store and the server's own count."""
    questions = {f"question {number}" for number in range(count)}
    assert answers == {f"{question}!": 2 for question in questions}
    assert Counter(stored(root)) == dict.fromkeys(questions, 1)
    assert len(server.billed) == server.billed.total() == count
    assert server.tried.total() > 1.2 * count
    assert server.most <= 64


@pytest.mark.slow
@pytest.mark.parametrize("provider", ["anthropic", pytest.param("openai", marks=pytest.mark.slow)])
def test_small_storm(provider: str, tmp_path: Path) -> None:
    """400 requests, 30 % faults, 64 in flight."""
    with serving(Script(rate=0.3, seed=1)) as server:
        expect_each_once(server, tmp_path, ask(server.url, tmp_path, 400, provider), 400)


@pytest.mark.long
def test_great_storm(tmp_path: Path) -> None:
    """10,000 requests, 30 % faults, 64 in flight; then a second run asks for nothing."""
    with serving(Script(rate=0.3, seed=2)) as server:
        expect_each_once(server, tmp_path, ask(server.url, tmp_path, 10_000), 10_000)
        tried = server.tried.total()
        ask(server.url, tmp_path, 10_000)
        assert server.tried.total() == tried


_RUN = """
import sys
from pathlib import Path
from test_llm_faults import ask
ask(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))
"""


def kill_at(server: LLMServer, root: Path, goal: float, count: int) -> None:
    """Let a run go until so many answers are stored, and kill it."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    child = subprocess.Popen([sys.executable, "-c", _RUN, server.url, str(root), str(count)], env=environment)
    while len(list(root.glob("completions/*/*.json"))) < goal:
        assert child.poll() is None
        time.sleep(0.002)
    child.send_signal(signal.SIGKILL)
    assert child.wait() == -signal.SIGKILL
    while server.open:  # what the dead run still had in flight
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("kills", "count"), [pytest.param(2, 300, marks=pytest.mark.slow), pytest.param(10, 4_000, marks=pytest.mark.long)]
)
def test_killed_run_asks_for_no_stored_answer_again(kills: int, count: int, tmp_path: Path) -> None:
    """Killed in its middle, several times: what was stored before a kill is never asked for after it."""
    rng = random.Random(0)
    safe: list[tuple[int, set[str]]] = []  # requests the server had seen at a kill, and the questions stored by then
    with serving(Script(rate=0.3, seed=3, delay=0.02)) as server:
        for kill in range(1, kills + 1):
            kill_at(server, tmp_path, count * (kill - rng.random() / 2) / (kills + 1), count)
            safe.append((len(server.bodies), {*stored(tmp_path)}))
        ask(server.url, tmp_path, count)
        asked = [text_of(body) for body in server.bodies]
    assert len({*stored(tmp_path)}) == count
    assert 0 < len(safe[0][1]) < len(safe[-1][1]) < count
    assert [questions & {*asked[seen:]} for seen, questions in safe] == [set()] * kills
