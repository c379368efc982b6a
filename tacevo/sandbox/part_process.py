"""Decisions of a part, each in a confined process of its own; of what it sends, nothing is trusted.

What it promises: a decision follows from the part's recorded sources, its settings and what is given. A part that
hangs, raises, or decides by a clock or a generator of its own is an error that names it, and never a decision.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from tacevo.errors import PartError
from tacevo.parts.kinds import Kind
from tacevo.records import Json, Limits, Record
from tacevo.sandbox.client import AnswerError, Died, Sandbox
from tacevo.typed import UncheckedJson

#: The limits of one decision.
LIMITS = Limits(seconds=20.0, memory_mib=1024)

#: One thread, and the instructions that every CPU with AVX2 has, so that sums come out alike.
_ENVIRONMENT = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    "OPENBLAS_CORETYPE": "Haswell",
    # By the names of any NumPy from 2.0 on, which passes over those that it does not know.
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512F AVX512CD AVX512_KNL AVX512_KNM AVX512_SKX AVX512_CLX AVX512_CNL "
    "AVX512_ICL AVX512_SPR",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """A part as a run records it."""

    kind: Kind
    name: str
    module: str
    attribute: str
    #: The texts by file (`tacevo.parts.sources.read_sources`), and their hash
    #: (`tacevo.config.recorded_parts.code_hash`).
    sources: Mapping[str, str]
    sha256: str = ""
    settings: Mapping[str, Json] = field(default_factory=dict)

    @property
    def place(self) -> str:
        """The setting that chose it, for an error."""
        return f"{self.kind.setting}={self.name}"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Answer(Record):
    """The message of a part's process: an answer, or what the part raised."""

    answer: UncheckedJson = None
    fault: str | None = None
    #: The number of coordinates of each point, where points stand behind the message as float64; None without points.
    columns: int | None = None


class PartProcess:
    """Runs the methods of parts, each in fresh processes; made when it is first needed, ended by `close`.

    `limits` are those of one decision.
    """

    def __init__(self, limits: Limits = LIMITS) -> None:
        self._limits = limits
        self._sandbox: Sandbox | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End all its processes."""
        if self._sandbox is not None:
            self._sandbox.close()
            self._sandbox = None

    def ask(self, part: Recorded, method: str, given: Json) -> Json:
        """Make one decision twice, and return it.

        Raises:
            PartError: the part raised, took too long or too much memory, or decided otherwise the second time.
            SandboxError: processes cannot be confined here.
        """
        first, second = (self._once(part, method, given, process) for process in range(2))
        if first != second:
            raise PartError(
                f"{_brief(first)}, and then {_brief(second)}, for the same",
                place=f"{part.place}, {method}",
                expected="a decision that follows from what is given",
                remedy="draw from `rng` alone; read no clock, no global generator, no address of an object",
            )
        return first

    def _once(self, part: Recorded, method: str, given: Json, process: int) -> Json:
        if self._sandbox is None:
            entries = {"decide": "tacevo.sandbox.part:decide"}
            self._sandbox = Sandbox(entries=entries, environment=_ENVIRONMENT, arrays={})
        header: dict[str, Json] = {
            "sources": dict(part.sources),
            "module": part.module,
            "attribute": part.attribute,
            "base": part.kind.base,
            "settings": dict(part.settings),
            "method": method,
            "given": given,
            "process": process,
        }
        outcome = self._sandbox.run("decide", header, b"", self._limits)
        if isinstance(outcome, Died):
            got, expected = f"{outcome.reason}: {outcome.detail}", "a decision"
            raise PartError(got, place=f"{part.place}, {method}", expected=expected)
        try:
            (frame,) = outcome.frames
            answer = frame.read(_Answer)
            decided = answer.answer if answer.columns is None else _points(frame.payload, answer.columns)
        except (AnswerError, ValueError) as error:
            raise PartError(str(error), place=f"{part.place}, {method}", expected="one decision") from error
        if answer.fault is not None:
            raise PartError(answer.fault, place=f"{part.place}, {method}", expected="a decision")
        return decided


def _points(payload: bytes, columns: int) -> list[Json]:
    """Read points, whose coordinates follow one another; raises a ValueError where these are no whole points."""
    return [list(point) for point in np.frombuffer(payload).reshape(-1, columns).tolist()] if columns else []


def _brief(value: Json, limit: int = 80) -> str:
    text = json.dumps(value)
    return text if len(text) <= limit else f"{text[: limit - 3]}..."
