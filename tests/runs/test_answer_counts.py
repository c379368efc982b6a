"""Promise: a generation without one usable answer is told, and two in a row stop a search that can go on."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from refusals import refused
from smallest import SMALLEST, UNTRACKED
from tests_own import Drawn

from tacevo.cli.app import main
from tacevo.cli.search import print_end
from tacevo.config.compose import compose
from tacevo.config.task_texts import load_task
from tacevo.errors import LLMError
from tacevo.evolution.development import Outcome
from tacevo.evolution.lines import GenerationLine
from tacevo.evolution.proposals import Proposal
from tacevo.evolution.run_files import read_ledger
from tacevo.llm.recording import RecordingLLM, unkept
from tacevo.parts.provider import Keep
from tacevo.records import Completion, Operator, Reason, Rejection, Request, Stage
from tacevo.runs.answer_counts import UsableAnswers
from tacevo.runs.datasets import load_data
from tacevo.runs.progress import Progress
from tacevo.runs.session import Result, record
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.store import Store

#: A search whose baseline is recorded in `published`.
OVERRIDES = [*SMALLEST, UNTRACKED, "search.candidates=2", "search.initial=2", "run.dir=run"]

RUBBISH = "\n  \x1b[31mI am sorry,\tI cannot do that.\u202e\nIndeed.\n"


def outcome(name: str, text: str, reason: Reason | None = Reason.no_class) -> Outcome:
    """Make the outcome of an answer."""
    request = Request(model="m", system="", messages=(), temperature=0.5, max_tokens=9, draw=0)
    proposal = Proposal(
        generation=int(name[1:3]), slot=int(name[4:]), operator=Operator.mutation, parents=(), prompt=0, request=request
    )
    completion = Completion(text=text, model="m", stop_reason="end_turn", input_tokens=1, output_tokens=1)
    result = Rejection(stage=Stage.extract, reason=reason or Reason.empty, detail="expected a class; got none")
    return Outcome(proposal=proposal, completion=completion, admitted=None, result=result, seconds=0.0, cpu_seconds=0.0)


def test_warning_has_the_commonest_reason_and_a_printable_sample() -> None:
    """Of the first answer that was rejected for it: its first line that is not blank, in one line, cut."""
    usable = UsableAnswers(2)
    usable.take(outcome("g01s00", "", Reason.empty))
    for slot in (1, 2):
        usable.take(outcome(f"g01s0{slot}", RUBBISH if slot == 1 else "x" * 1000))
    warning = usable.close(1)
    assert warning is not None
    assert warning.startswith("generation 1: not one of 3 answers")
    assert "extract: no_class (2 of 3)" in warning
    assert "g01s01" in warning
    assert r'"\x1b[31mI am sorry, I cannot do that.\u202e"' in warning
    assert warning.isprintable()
    for _ in range(3):
        usable.take(outcome("g02s00", "x" * 1_000_000))
    assert len(usable.close(2) or "") < 400


@pytest.mark.parametrize("most", [1, 2, 3, None])
def test_so_many_generations_in_a_row_stop(most: int | None) -> None:
    """One that asked for nothing, or had one usable answer, begins the count again."""
    usable = UsableAnswers(most)
    usable.take(outcome("g00s01", RUBBISH))
    usable.close(0)
    assert usable.close(1) is None  # asked for nothing
    for generation in range(2, 5):
        usable.take(outcome(f"g0{generation}s01", RUBBISH))
        usable.close(generation)
        if most is not None and generation - 1 >= most:
            with refused(LLMError, place="search.stop_after_unusable", got=f"generation {generation}: not one of 1"):
                usable.check()
        else:
            usable.check()


class Rubbish:
    """Answers nothing that can be used, but for the requests after so many."""

    def __init__(self, usable_after: int = 10_000) -> None:
        self.asked = 0
        self._usable_after = usable_after

    def complete(self, requests: Sequence[Request], keep: Keep) -> Iterator[tuple[int, Completion]]:
        """Answer in order."""
        for position, request in enumerate(requests):
            self.asked += 1
            ((_, good),) = Drawn(model="drawn", slip_rate=0.0).complete([request], unkept)
            yield position, keep(request, good if self.asked > self._usable_after else replace(good, text=RUBBISH))


Searching = Callable[..., Result]


@pytest.fixture
def search(folder: Path) -> Searching:
    """Return what searches in this directory, with its recorded baseline and a server of rubbish."""

    def run(*more: str, llm: Rubbish, into: str = "other") -> Result:
        config = compose([*OVERRIDES, *more, f"run.dir={into}", f"store.root={folder / 'cache'}", "llm.slip_rate=0.5"])
        data = load_data(config, Progress())
        answered = RecordingLLM(llm, Store(folder / "cache", "completions"))
        return record(config, load_task(config, data.facts), data, Progress(), llm=answered)

    return run


def generations(folder: str) -> int:
    """Count the generations that a ledger has."""
    return sum(isinstance(line, GenerationLine) for line in read_ledger(RunDirectory(Path(folder))).lines)


@pytest.mark.slow
def test_search_of_rubbish_stops_and_goes_on(search: Searching, capsys: pytest.CaptureFixture[str]) -> None:
    """After generation 1, with all kept, and after each one more; with a better server as if it had never stopped."""
    for ended in (2, 3):  # what was recorded before does not stop it, and counts
        with pytest.raises(LLMError):
            search("search.generations=4", llm=(bad := Rubbish()))
        assert (bad.asked, generations("other")) == (4 if ended == 2 else 2, ended)
        told = capsys.readouterr().err
        assert told.count("not one of 2 answers could be used") == ended
    assert "trivial" in told.splitlines()[1]
    better = Rubbish(usable_after=0)
    digest = search("search.generations=4", llm=better).digest
    assert better.asked == 4  # those of the last two generations; the others were kept
    same = search("search.generations=4", "search.stop_after_unusable=null", llm=Rubbish(), into="never")
    assert same.digest == digest
    assert main(["replay", "never"]) == 0
    assert main(["replay", "other"]) == 0


def test_useless_search_that_is_at_its_end_has_a_summary(search: Searching, capsys: pytest.CaptureFixture[str]) -> None:
    """It is whole, and its end reads like no success."""
    result = search("search.generations=1", llm=Rubbish())
    assert not result.succeeded
    assert "Nothing beat the baseline." in result.summary
    assert "Best fitness" not in result.summary
    capsys.readouterr()
    print_end(result)
    out = capsys.readouterr().out
    assert "tacevo noise" not in out
    assert "next:" not in out
    assert out.splitlines()[-1] == f"digest: {result.digest}"
    assert RunDirectory(Path("other")).read_run().digest == result.digest
