"""Promise: the test server counts what it delivered and nothing else, and its faults follow from its seed."""

import json
import urllib.request
from collections import Counter
from pathlib import Path

import pytest
from hosted import KEY, hosted, request
from llm_script import PASSING, Script, key_of
from llm_server import recorded_answers, serving

ANSWERS = Path(__file__).parents[2] / "shared" / "llm_answers"


def body(text: str) -> dict[str, object]:
    """Make a request's body."""
    return {"model": "m", "messages": [{"role": "user", "content": text}]}


def post(url: str, text: str) -> dict[str, object]:
    """Ask by hand."""
    data = json.dumps(body(text)).encode()
    with urllib.request.urlopen(urllib.request.Request(f"{url}/v1/messages", data=data, method="POST")) as answer:
        return dict(json.load(answer))


def test_faults_follow_from_the_seed() -> None:
    """The same plan twice, another one under another seed, and about as many faults as asked for."""
    plans = [
        [Script(seed=seed, rate=0.3).fault(body(str(n)), tried) for n in range(500) for tried in (1, 2)]
        for seed in (0, 0, 1)
    ]
    assert plans[0] == plans[1] != plans[2]
    counts = Counter(plans[0])
    assert set(counts) == {"", *PASSING}
    assert 0.25 < 1 - counts[""] / 1000 < 0.35


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


@pytest.mark.skipif(not ANSWERS.exists(), reason="the recorded answers are not here")
def test_recorded_answers_are_served(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each request gets one of the task's answers, always the same."""
    monkeypatch.setenv("ANTHROPIC_API_KEY", KEY)
    with serving(recorded_answers(ANSWERS, "force")) as server:
        first, again = (
            [completion.text for _, completion in sorted(hosted(server.url).complete(asked), key=lambda pair: pair[0])]
            for asked in ([request(str(n)) for n in range(30)],) * 2
        )
    assert first == again
    assert len(set(first)) > 5
    assert all("class ImageRegressionCNN" in text for text in first)
