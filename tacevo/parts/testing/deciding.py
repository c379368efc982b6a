"""The promises of parts that decide the results of a run."""

import copy
import dataclasses
import inspect
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from tacevo.parts.kinds import Kind
from tacevo.parts.registry import Part
from tacevo.parts.sources import read_sources
from tacevo.parts.testing.contract import BrokenError, Contract, check_frozen, require
from tacevo.parts.testing.samples import ask
from tacevo.records import Json
from tacevo.runs.decisions import brought_part
from tacevo.sandbox.part import METHODS
from tacevo.sandbox.part_process import PartProcess, Recorded


def deciding_contracts(part: Any, kind: Kind) -> list[Contract]:
    """List what such a part promises; one of ours decides in the process that searches, and promises less."""
    tested = _Tested(part, kind)
    everywhere = [
        Contract("is a frozen dataclass, with settings that are numbers, true or false, or text", tested.settings),
        Contract("decides whatever a search may ask: only of what is given, and only finite numbers", tested.decides),
        Contract("decides alike when it is asked again, whatever it was asked in between", tested.keeps_nothing),
        Contract("does not change what it is given", tested.changes_nothing),
    ]
    if type(part).__module__.startswith("tacevo."):
        return everywhere
    return [
        *everywhere,
        Contract("imports its own modules, and nothing else that a clock or a file could be behind", tested.imports),
        Contract(
            "decides alike in a confined process, with another clock and other global generators", tested.confined
        ),
    ]


class _Here:
    """Lets a part decide in this process, and remembers what it was asked (`tacevo.runs.decisions.Asked`)."""

    def __init__(self, part: Any) -> None:
        self._part = part
        #: Method, what was given, the decision.
        self.asked: list[tuple[str, Json, Json]] = []
        #: The methods that changed what they were given.
        self.changed: set[str] = set()

    def ask(self, part: Recorded, method: str, given: Json) -> Json:
        """Return the decision."""
        answer = self.again(method, given)
        self.asked.append((method, given, answer))
        return answer

    def again(self, method: str, given: Json) -> Json:
        """Return the decision, without remembering it."""
        asked = METHODS[method]
        arguments = asked.arguments(given)
        before = copy.deepcopy(_comparable(arguments))
        answer = asked.answer(getattr(self._part, asked.name)(*arguments))
        if _comparable(arguments) != before:
            self.changed.add(asked.name)
        return answer


def _comparable(arguments: tuple[Any, ...]) -> list[Any]:
    """Leave out the generator, which is there to be drawn from."""
    return [each for each in arguments if not isinstance(each, np.random.Generator)]


class _Tested:
    """A part with the questions that it was asked."""

    def __init__(self, part: Any, kind: Kind) -> None:
        self._part, self._kind = part, kind
        self._here: _Here | None = None

    def settings(self) -> None:
        """The part's fields are what a configuration can hold."""
        check_frozen(self._part)
        for field in dataclasses.fields(self._part):
            value = getattr(self._part, field.name)
            holds = type(value) in (int, float, bool, str) and (type(value) is not float or math.isfinite(value))
            require(holds, f"a setting {field.name} that is a number, true or false, or text", repr(value))

    def decides(self) -> None:
        """Every question has an answer that a search accepts."""
        self._answers()

    def keeps_nothing(self) -> None:
        """The answers are the same in the other order."""
        here = self._answers()
        for method, given, answer in reversed(here.asked):
            again = here.again(method, given)
            require(again == answer, f"{json.dumps(answer)} of {method}, as the first time", json.dumps(again))

    def changes_nothing(self) -> None:
        """The arguments that the part was given are as they were."""
        here = self._answers()
        require(not here.changed, "arguments that stay as they are", f"changes by {', '.join(sorted(here.changed))}")

    def imports(self) -> None:
        """The part's sources can be recorded."""
        read_sources(self._place())

    def confined(self) -> None:
        """The answers of fresh, confined processes are those of this one; sums may differ in their last bits."""
        here = self._answers()
        part = self._place()
        recorded = dataclasses.replace(
            self._recorded(), module=part.module, sources=read_sources(part), settings=dataclasses.asdict(self._part)
        )
        with PartProcess() as process:
            process.ask(recorded, "describe", {"constants": list(self._kind.constants)})
            for method, given, answer in here.asked:
                there = process.ask(recorded, method, given)
                require(_alike(answer, there), f"{json.dumps(answer)} of {method}, as here", json.dumps(there))

    def _answers(self) -> _Here:
        """Ask all questions, once."""
        if self._here is None:
            here = _Here(self._part)
            constants = {name: getattr(type(self._part), name) for name in self._kind.constants}
            ask(self._kind, brought_part(self._recorded(), constants, here))
            self._here = here
        return self._here

    def _recorded(self) -> Recorded:
        made = type(self._part)
        return Recorded(
            kind=self._kind, name=made.__name__, module=made.__module__, attribute=made.__qualname__, sources={}
        )

    def _place(self) -> Part:
        """Return where its class is: in a module of a package, or in a file."""
        made = type(self._part)
        try:
            file = Path(inspect.getfile(made))
        except (OSError, TypeError) as error:
            raise BrokenError(f"expected a class in a file; got {made.__name__} of {made.__module__}") from error
        is_packed = "." in made.__module__
        return Part(
            kind=self._kind,
            name=made.__name__,
            module=made.__module__ if is_packed else file.stem,
            attribute=made.__qualname__,
            origin=str(file),
            file=None if is_packed else file,
        )


def _alike(first: Json, second: Json) -> bool:
    """Compare two answers; of numbers with a fraction the first nine digits."""
    if isinstance(first, list) and isinstance(second, list):
        return len(first) == len(second) and all(map(_alike, first, second))
    if isinstance(first, float) and isinstance(second, float):
        return math.isclose(first, second, rel_tol=1e-9, abs_tol=1e-12)
    return first == second
