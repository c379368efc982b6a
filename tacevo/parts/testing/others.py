"""The promises of providers, trackers, outputs and commands."""

import argparse
import inspect
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from tacevo.parts.output import Output
from tacevo.parts.testing.contract import Contract, require
from tacevo.records import ChatMessage, Completion, Request

_NETWORK = """\
class Network(nn.Module):
    def __init__(self, outputs):
        super().__init__()
        self.layers = nn.Sequential(nn.Conv2d(3, 8, 3), nn.ReLU(), nn.AdaptiveAvgPool2d(1), nn.Flatten())
        self.head = nn.Linear(8, outputs)

    def forward(self, x):
        return self.head(self.layers(x))"""

_STOPS = frozenset({"end_turn", "max_tokens", "refusal", "unknown", "invalid_request", "key_repeated"})


def provider_contracts(provider: Any) -> list[Contract]:
    """List what a provider promises; it is asked two short requests, which may cost what its server charges."""

    def answers() -> None:
        """Each request has one answer, which `keep` got, and what `keep` returned is yielded."""
        requests = [_request(str(getattr(provider, "model", "") or "model"), draw) for draw in range(2)]
        kept: dict[int, list[Completion]] = {draw: [] for draw in range(2)}

        def keep(request: Request, answer: Completion) -> Completion:
            require(request in requests, "`keep` to be called with a request as it came", request)
            require(isinstance(answer, Completion), "a tacevo.records.Completion", type(answer).__name__)
            require(answer.stop_reason in _STOPS, f"a stop_reason of {', '.join(sorted(_STOPS))}", answer.stop_reason)
            json.dumps(answer.text).encode("utf-8", "strict")
            kept[request.draw].append(replace(answer))
            return kept[request.draw][-1]

        yielded = dict[int, Completion]()
        for position, answer in provider.complete(requests, keep):
            require(position not in yielded, "each position once", position)
            yielded[position] = answer
        require(sorted(yielded) == [0, 1], "the positions of all requests, 0 and 1", sorted(yielded))
        for position, answer in yielded.items():
            require(len(kept[position]) == 1, "one call of `keep` for a request", len(kept[position]))
            require(answer is kept[position][0], "what `keep` returned to be yielded", "another answer")

    def answers_nothing() -> None:
        """No request, no answer."""
        answers = list(provider.complete([], lambda request, answer: answer))
        require(not answers, "no answer without a request", answers)

    return [
        Contract("answers each request once, by `keep`", answers),
        Contract("answers nothing where nothing is asked", answers_nothing),
    ]


def _request(model: str, draw: int) -> Request:
    text = f"Parent network:\n\n```python\n{_NETWORK}\n```\n\nInstruction: Widen a convolution.\n"
    return Request(
        model=model,
        system="Answer with one class.",
        messages=(ChatMessage(role="user", content=text),),
        temperature=0.5,
        max_tokens=500,
        draw=draw,
    )


def tracker_contracts(tracker: Any) -> list[Contract]:
    """List what a tracker promises."""

    def never_stops() -> None:
        """Neither an empty directory of a run nor one that is not there makes it raise."""
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "run").mkdir()
            mirror = tracker.mirror([Path(folder) / "run", Path(folder) / "missing"])
            if mirror is not None:
                said = mirror.finish(30.0)
                one_line = said is None or (isinstance(said, str) and "\n" not in said)
                require(one_line, "`finish` to return None, or one line of text", said)

    def views() -> None:
        """The tracker says where to look in one line."""
        said = tracker.viewing()
        require(isinstance(said, str) and "\n" not in said, "`viewing` to return one line, which may be empty", said)

    return [
        Contract("stops no run, whatever it cannot mirror", never_stops),
        Contract("says in one line where to look", views),
    ]


def output_contracts(output: Any, run: str | os.PathLike[str] | None) -> list[Contract]:
    """List what an output promises; with a run or a sweep, also what it adds to that."""
    own = [name for name in vars(Output) if not name.startswith("_") and name in vars(type(output))]

    def made() -> None:
        """The output has no settings."""
        type(output)()

    def adds() -> None:
        """The output overrides something, with the parameters that it is called with."""
        known = [name for name in vars(Output) if not name.startswith("_")]
        require(bool(own), f"a method of its own among {', '.join(known)}", "none")
        for name in own:
            needed = list(inspect.signature(getattr(Output, name)).parameters)
            found = list(inspect.signature(getattr(type(output), name)).parameters)
            require(len(found) == len(needed), f"{name}({', '.join(needed)})", f"{name}({', '.join(found)})")

    def writes() -> None:
        """Nothing raises, all can be written and drawn, and equal records give equal tables and sections."""
        from tacevo.api.trying import faults_of

        assert run is not None
        faults = faults_of(output, run)
        require(not faults, "nothing left out", "; ".join(faults))

    return [
        Contract("is made without arguments", made),
        Contract("adds something by methods that can be called", adds),
        *([] if run is None else [Contract(f"adds the same again to {Path(run).name}, and all of it", writes)]),
    ]


def command_contracts(command: Callable[[argparse.ArgumentParser], object]) -> list[Contract]:
    """List what the function of a command promises."""

    def describes() -> None:
        """The command adds its arguments, and names the function that runs."""
        parser = argparse.ArgumentParser(prog="tacevo name")
        command(parser)
        parser.format_help()
        runs = parser.get_default("command")
        require(callable(runs), "parser.set_defaults(command=FUNCTION)", runs)

    return [Contract("describes its arguments, and names the function that runs it", describes)]
