"""The kit finds what breaks a contract, of every kind, and finds nothing in parts that keep theirs."""

from argparse import ArgumentParser
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import honest
import numpy as np
import pytest
from checkout import PUBLISHED, ROOT

from analysis.table import Table
from tacevo.evolution import fitness, instructions, parents
from tacevo.parts.output import Output
from tacevo.parts.provider import Keep
from tacevo.parts.registry import import_file
from tacevo.parts.source import Catalogue
from tacevo.parts.testing import check, contracts, kind_of
from tacevo.records import Completion, Json, Kind, Request
from tacevo.runs.local import Local

LAB = ROOT / "tests/support/lab/mylab.py"


def broken(part: object) -> list[str]:
    """List the promises that a part breaks."""
    return [str(contract) for contract in contracts(part) if contract.fault()]


HONEST = [honest.Greedy(), honest.Last(), honest.Falling(), honest.Half(), honest.Size(), honest.Rows()]

OURS = [
    *(parents.Uniform(), parents.Best(5), parents.Curious(), parents.BestK(), parents.Baseline(), parents.Nobody()),
    *(instructions.Uniform(), instructions.Curious(), instructions.Effect(), instructions.Unrecorded()),
    *(fitness.Last(), fitness.Lowest(), fitness.MeanOf3()),
]


@pytest.mark.parametrize("part", [*HONEST, *OURS], ids=lambda part: f"{type(part).__module__}.{type(part).__name__}")
def test_sound_parts_that_decide_pass(part: object) -> None:
    """Those of a user, also confined, and ours."""
    check(part)


@pytest.mark.parametrize("name", ["Robot", "Echo", "Lab", "Notes", "Widths", "greet"])
def test_sound_parts_of_every_other_kind_pass(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A source, a provider, an executor, a tracker, an output and a command."""
    monkeypatch.chdir(tmp_path)  # where the tracker writes
    settings: dict[str, Any] = {
        "Robot": {"image_size": 32},
        "Echo": {"model": "parrot"},
        "Lab": {"workers": 2},
        "Notes": {"uri": ""},
    }
    made = getattr(import_file(LAB), name)
    check(made(**settings.get(name, {})) if isinstance(made, type) else made)


#: How a rule breaks a promise: a word of the promise, and the body of its `draw`.
RULES = {
    "other candidates": ("decides whatever", "import dataclasses\nreturn [dataclasses.replace(pool[0], id='g99s99')]"),
    "one twice": ("decides whatever", "return [pool[0]] * number"),
    "too few": ("decides whatever", "return [pool[0]]"),
    "an error": ("decides whatever", "return [pool[number + 1]]"),
    "state": (
        "asked again",
        "CALLS.append(1)\nreturn pool[len(CALLS) % 2 :][:number] if len(pool) > 2 else pool[:number]",
    ),
    "a change": ("does not change", "pool.reverse()\nreturn pool[:number]"),
    "an import": ("imports its own", "import time\nreturn pool[:number]"),
    "another generator": (
        "confined",
        "start = int(np.random.get_state()[1][0]) % 2\n"
        "return pool[start:][:number] if len(pool) > 2 else pool[:number]",
    ),
}


def rule(folder: Path, body: str) -> Any:
    """Write a rule that chooses parents with this body of `draw` into a file, and import it."""
    lines = "\n".join(f"        {line}" for line in body.split("\n"))
    file = folder / "rule.py"
    file.write_text(
        "from dataclasses import dataclass\nimport numpy as np\nfrom tacevo.parts import Parents\nCALLS = []\n"
        f"@dataclass(frozen=True)\nclass Rule(Parents):\n    def draw(self, pool, number, rng):\n{lines}\n"
    )
    return import_file(file).Rule


@pytest.mark.parametrize("case", RULES)
def test_rule_that_breaks_a_promise_is_found(tmp_path: Path, case: str) -> None:
    """Each way by the contract that it breaks."""
    promise, body = RULES[case]
    assert any(promise in each for each in broken(rule(tmp_path, body)()))


@dataclass(frozen=True)
class Shades:
    """A source of grey pictures, sound as it is."""

    image_size: int = 8
    root: Path | None = None

    def describe(self) -> Json:
        return {"source": "shades", "size": self.image_size}

    def catalogue(self) -> Catalogue:
        labels = np.arange(40, dtype=np.float64)[:, None]
        return Catalogue(
            kind=Kind.regression,
            names=("shade",),
            labels=labels,
            image_size=self.image_size,
            pictures=[partial(self.picture, row) for row in range(40)],
            groups=np.arange(40, dtype=np.int64) // 2,
        )

    def picture(self, row: int) -> Any:
        return np.full((3, self.image_size, self.image_size), row, np.uint8)


class Named(Shades):
    def describe(self) -> Json:
        return {"root": str(self.root)}


class Restless(Shades):
    def describe(self) -> Json:
        return {"object": id(object()), "at": np.random.default_rng().integers(2**60).item()}


class Few(Shades):
    def catalogue(self) -> Catalogue:
        listed = super().catalogue()
        return replace(listed, pictures=listed.pictures[:-1])


class Whole(Shades):
    def catalogue(self) -> Catalogue:
        listed = super().catalogue()
        return replace(listed, labels=listed.labels.astype(np.int64))


class Shuffled(Shades):
    def catalogue(self) -> Catalogue:
        listed = super().catalogue()
        return replace(listed, labels=np.random.default_rng().permutation(listed.labels))


class Grey(Shades):
    def picture(self, row: int) -> Any:
        return np.full((self.image_size, self.image_size), row, np.uint8)


class Noisy(Shades):
    def picture(self, row: int) -> Any:
        return np.random.default_rng().integers(0, 255, (3, self.image_size, self.image_size), np.uint8)


def test_sound_source_passes(tmp_path: Path) -> None:
    """With files of its own, too."""
    check(Shades())
    (tmp_path / "log").mkdir()
    check(Shades(root=tmp_path / "log"))


@pytest.mark.parametrize(
    ("kind", "promise"),
    [
        (Named, "by their bytes"),
        (Restless, "describes itself"),
        (Few, "fit together"),
        (Whole, "fit together"),
        (Shuffled, "the same again"),
        (Grey, "makes pictures"),
        (Noisy, "same picture again"),
    ],
)
def test_source_that_breaks_a_promise_is_found(tmp_path: Path, kind: type[Shades], promise: str) -> None:
    """Each way by the contract that it breaks."""
    (tmp_path / "log").mkdir()
    assert any(promise in each for each in broken(kind(root=tmp_path / "log")))


@dataclass(frozen=True)
class Provider:
    """A provider that answers wrongly."""

    twice: bool = False
    passes_by: bool = False
    silent: bool = False
    word: str = "end_turn"

    def complete(self, requests: Sequence[Request], keep: Keep) -> Iterator[tuple[int, Completion]]:
        for position, request in enumerate(requests[: 1 if self.silent else None]):
            answer = Completion(text="x", model="m", stop_reason=self.word, input_tokens=1, output_tokens=1)
            kept = keep(request, answer)
            yield position, answer if self.passes_by else kept
            if self.twice:
                yield position, keep(request, answer)


@pytest.mark.parametrize("wrong", [{"twice": True}, {"passes_by": True}, {"silent": True}, {"word": "stop"}])
def test_provider_that_breaks_a_promise_is_found(wrong: dict[str, Any]) -> None:
    """It answers twice, not at all, by `keep`'s side, or with a word that nobody knows."""
    check(Provider())
    assert broken(Provider(**wrong)) == ["answers each request once, by `keep`"]


class Empty(Output):
    pass


class Wrong(Output):
    def tables(self, run: object) -> Any:  # type: ignore[override]
        return ()


@dataclass(frozen=True)
class Raising:
    def mirror(self, runs: Sequence[Path]) -> None:
        raise OSError("no such server")

    def viewing(self) -> str:
        return "one\ntwo"


def idle(parser: ArgumentParser) -> None:
    parser.add_argument("name")


@pytest.mark.parametrize(("part", "number"), [(Empty(), 1), (Wrong(), 1), (Raising(), 2), (idle, 1)])
def test_others_that_break_promises_are_found(part: object, number: int) -> None:
    """An output that adds nothing or cannot be called, a tracker that raises, a command that runs nothing."""
    assert len(broken(part)) == number


class Fickle(Output):
    """Another table each time."""

    count = 0

    def tables(self, run: object, profiles: object) -> Any:
        Fickle.count += 1
        return [Table(name="count", caption="Calls.", columns=("calls",), rows=((Fickle.count,),))]


class Lost(Output):
    def sweep_section(self, sweep: object) -> Any:
        raise KeyError("lost")


@pytest.mark.room("page", "figures")
@pytest.mark.parametrize(
    ("output", "place", "words"),
    [
        (Fickle(), PUBLISHED / "force-variants.zip", "the same again"),
        (Lost(), ROOT / "examples/lexicase.zip", "KeyError: 'lost', test_kit.py, line"),
    ],
    ids=["another table", "a section that raises"],
)
def test_output_is_tried_with_records(output: Output, place: Path, words: str) -> None:
    """What it breaks there is named, and nowhere else."""
    assert all(contract.fault() == "" for contract in contracts(output))
    *kept, last = contracts(output, run=place)
    assert all(contract.fault() == "" for contract in kept)
    assert words in last.fault()


def test_executor_of_ours_passes() -> None:
    """The one that everybody has."""
    check(Local())


def test_what_is_no_part_is_refused() -> None:
    """With words that say what is one."""
    assert kind_of(3) is None
    with pytest.raises(TypeError, match="protocol"):
        contracts(object())


def test_check_names_every_broken_promise(tmp_path: Path) -> None:
    """One line for each, whatever the part raises."""
    with pytest.raises(AssertionError, match="IndexError") as caught:
        check(rule(tmp_path, "return [pool[number + 100]]")())
    assert len(str(caught.value).splitlines()) > 1
