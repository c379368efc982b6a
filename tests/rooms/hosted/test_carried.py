"""Promise: where a hosted model takes no temperature, that is told before the first request, or words carry it."""

import json
from pathlib import Path

import pytest
from llm_models import MODELS
from llm_script import Body, Script, key_of
from llm_server import LLMServer, serving
from smallest import ARCHIVES, TOUCHES, UNTRACKED

from tacevo.cli.app import main

pytestmark = pytest.mark.usefixtures("keys")

TINY = [
    *TOUCHES,
    *ARCHIVES,
    UNTRACKED,
    "llm=anthropic",
    "search.generations=1",
    "search.candidates=2",
    "search.initial=2",
    "executor.workers=1",
    "run.dir=run",
]

TODAY = "llm.model=claude-haiku-5-5"


def network(body: Body) -> str:
    """Answer with a network whose width follows from the request."""
    width = 2 + int(key_of(body), 16) % 7
    return (
        "```python\nclass ImageRegressionCNN(nn.Module):\n    def __init__(self, num_outputs=3):\n"
        f"        super().__init__()\n        self.conv = nn.Conv2d(3, {width}, 3, stride=4)\n"
        f"        self.head = nn.Linear({width}, num_outputs)\n\n    def forward(self, x):\n"
        "        return self.head(self.conv(x).relu().mean((2, 3)))\n```\n"
    )


def search(server: LLMServer, *overrides: str) -> int:
    """Search with a server; return the exit status."""
    return main(["search", *TINY, f"llm.base_url={server.url}", *overrides])


def test_model_that_takes_no_temperature_is_asked_nothing(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The error names the choices; so does that of an effort that the model lacks; a sweep is then not even begun."""
    with serving(Script(answer=network, like=MODELS)) as server:
        assert search(server, TODAY) == 2
        said = capsys.readouterr().err
        assert "temperature.carrier=parameter: expected a model that takes a temperature" in said
        assert all(f"{carrier} (" in said for carrier in ("temperature.carrier=words", "effort", "none"))
        sweep = [each for each in TINY if not each.startswith("run.dir=")]
        arms = [f"llm.base_url={server.url}", TODAY, "temperature.carrier=parameter,words", "seed=0,1"]
        assert main(["search", "-m", *sweep, *arms]) == 2
        assert "temperature.carrier=parameter: expected" in capsys.readouterr().err
        assert not (place / "sweeps").exists()
        old = "llm.model=claude-haiku-4-5"
        assert search(server, old, "temperature.carrier=effort", "run.dir=other") == 2
        assert "temperature.efforts: expected a model with efforts" in capsys.readouterr().err
        assert not server.billed


@pytest.mark.parametrize("carrier", ["words", "effort", "none"])
def test_model_without_temperatures_is_asked_with_another_carrier(
    carrier: str, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No request has a temperature, none is refused, and the run replays to its digest without the server."""
    bodies: list[Body] = []

    def answer(body: Body) -> str:
        bodies.append(body)
        return network(body)

    with serving(Script(answer=answer, like=MODELS)) as server:
        assert search(server, TODAY, f"temperature.carrier={carrier}") == 0
    digest = capsys.readouterr().out.splitlines()[-1]
    assert len(bodies) == 4
    assert not [body for body in bodies if "temperature" in body]
    assert [("output_config" in body) for body in bodies] == [carrier == "effort"] * 4
    assert [("Boldness " in str(body["messages"])) for body in bodies] == [carrier == "words"] * 4
    lines = [json.loads(line) for line in (place / "run" / "ledger.jsonl").read_text().splitlines()]
    asked = [line for line in lines if line.get("answer")]
    assert {(line["carrier"], "level" in line, "dropped" in line) for line in asked} == {
        (carrier, carrier != "none", False)
    }
    assert main(["replay", "run"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == digest


def test_run_that_was_begun_without_its_temperature_goes_on(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As where a server refused it only when it was asked; another seed is a search that is not begun so."""
    with serving(Script(answer=network, refused=("temperature",))) as server:
        assert search(server) == 0
        assert search(server, "search.generations=2") == 0
        capsys.readouterr()
        assert search(server, "seed=1", "run.dir=other") == 2
        assert "which refuses temperatures" in capsys.readouterr().err


def test_new_search_does_not_recall_answers_without_their_temperature(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Even where every answer is recorded, and nothing would be asked; one that only reads the store says so once."""
    with serving(Script(answer=network, refused=("temperature",))) as server:
        assert search(server) == 0
    ledger = (place / "run" / "ledger.jsonl").read_bytes()
    capsys.readouterr()
    gone = "llm.base_url=http://127.0.0.1:9"
    assert main(["search", *TINY, gone, "run.dir=other"]) == 2
    assert "temperature.carrier=parameter: expected a model that takes a temperature" in capsys.readouterr().err
    assert not (place / "other").exists()
    assert main(["search", *TINY, gone, "run.dir=again", "llm.mode=replay"]) == 0
    assert capsys.readouterr().err.count("warning: no temperature is sent") == 1
    assert main(["search", *TINY, gone]) == 0  # it was begun so, and has nothing to do
    assert (place / "run" / "ledger.jsonl").read_bytes() == ledger


@pytest.mark.slow
def test_sweep_that_was_begun_without_temperatures_goes_on(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its other jobs are the same searches, with a warning; with another carrier they would be another sweep's."""
    settings = [each for each in TINY if not each.startswith("run.dir=")]
    with serving(Script(answer=network, refused=("temperature",))) as server:
        command = ["search", "-m", *settings, f"llm.base_url={server.url}", "--into", "sweep"]
        assert main([*command, "seed=0"]) == 0
        capsys.readouterr()
        assert main([*command, "seed=0,1"]) == 0
        assert "warning: no temperature is sent" in capsys.readouterr().err
        assert main(["search", "-m", *settings, f"llm.base_url={server.url}", "seed=2", "--into", "other"]) == 2
        assert "expected a model that takes a temperature" in capsys.readouterr().err
        assert search(server, "seed=3", "run.dir=sweep/mine") == 2  # which is no job of it
    lines = [json.loads(line) for line in (place / "sweep" / "none-seed1" / "ledger.jsonl").read_text().splitlines()]
    assert {tuple(line["dropped"]) for line in lines if line.get("answer")} == {("temperature",)}
