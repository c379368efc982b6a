"""A lab's own parts, as docs/parts.md tells a stranger to write them."""

import contextlib
import re
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.table import Table
from tacevo.parts.executor import Notice, Order
from tacevo.parts.output import Output
from tacevo.parts.provider import Keep
from tacevo.parts.source import Catalogue
from tacevo.records import Completion, Json, Kind, Request
from tacevo.sandbox.client import RunJob, Sandbox
from tacevo.sandbox.confinement import in_force

if TYPE_CHECKING:
    from collections.abc import Mapping

    from analysis.report.collection import Collection
    from tacevo.profile import Profile


@dataclass(frozen=True)
class Robot:
    """Two kinds of touch, as the log of a robot might hold them."""

    image_size: int
    touches: int = 40

    def describe(self) -> Json:
        """Name everything that decides the images."""
        return {"source": "mylab.Robot", "touches": self.touches, "image_size": self.image_size}

    def catalogue(self) -> Catalogue:
        """List the touches."""
        labels = np.arange(self.touches, dtype=np.int64) % 2
        return Catalogue(
            kind=Kind.classification,
            names=("left", "right"),
            labels=labels,
            image_size=self.image_size,
            pictures=[partial(self._picture, int(label)) for label in labels],
            groups=np.arange(self.touches, dtype=np.int64) // 2,
        )

    def _picture(self, label: int) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
        size = self.image_size
        image = np.full((3, size, size), 40, np.uint8)
        image[:, :, size // 2 * label : size // 2 * (label + 1)] = 200
        return image


@dataclass(frozen=True)
class Echo:
    """Answers with the parent, and a remark."""

    model: str
    remark: str = "as it was"

    def complete(self, requests: Sequence[Request], keep: Keep) -> Iterator[tuple[int, Completion]]:
        """Answer the requests in their order."""
        for position, request in enumerate(requests):
            (source, *_) = re.findall(r"```python\n(.*?)\n?```", request.messages[0].content, re.DOTALL)
            text = f"```python\n{source}\n# {self.remark}, draw {request.draw}\n```"
            yield (
                position,
                keep(
                    request,
                    Completion(text=text, model=self.model, stop_reason="end_turn", input_tokens=1, output_tokens=1),
                ),
            )


@dataclass(frozen=True)
class Lab:
    """Runs candidates in a sandbox of this machine, and says so."""

    workers: int

    def check(self, order: Order) -> None:
        """Need nothing more."""

    def ahead(self, order: Order) -> AbstractContextManager[None]:
        """Start nothing ahead."""
        return contextlib.nullcontext()

    @contextlib.contextmanager
    def open(
        self,
        order: Order,
        images: Path | None,
        *,
        started: None = None,
        notice: Notice | None = None,
        say: Callable[[str], None] | None = None,
        predict: Callable[["Mapping[str, Any]"], int | None] | None = None,
    ) -> Iterator[RunJob]:
        """Open a sandbox."""
        if say is not None:
            say(f"the lab runs {self.workers} candidates at once")
        arrays = {} if images is None else {"images": images}
        tell = None if notice is None else lambda measures: notice(in_force(measures))
        with Sandbox(entries=order.entries, environment=order.environment, arrays=arrays, notice=tell) as sandbox:
            yield sandbox.run


@dataclass(frozen=True)
class Notes:
    """Writes the names of mirrored runs into a file."""

    uri: str

    def mirror(self, runs: Sequence[Path]) -> "Written":
        """Write them down."""
        Path("notes.txt").write_text("".join(f"{run.name}\n" for run in runs), encoding="utf-8")
        return Written()

    def viewing(self) -> str:
        """Say where."""
        return "notes: notes.txt"


class Written:
    """What was written at once."""

    def finish(self, timeout: float | None) -> str | None:
        """Nothing is left to do."""
        return None


class Widths(Output):
    """Adds a table of how many candidates there are."""

    def tables(self, run: "Collection", profiles: "Mapping[str, Profile] | None") -> Sequence[Table]:
        """Make it."""
        rows = ((len(run.run.candidates),),)
        return [Table(name="widths", caption="Candidates.", columns=("candidates",), rows=rows)]


def greet(parser: ArgumentParser) -> None:
    """Describe the command."""
    parser.add_argument("name")
    parser.set_defaults(command=_greet)


def _greet(options: Namespace) -> int:
    print(f"hello, {options.name}")
    return 0
