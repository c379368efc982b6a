"""The count of a generation's usable answers; what is said where there is none, and when that stops a search."""

from collections import Counter

from tacevo.errors import LLMError
from tacevo.evolution.development import Outcome
from tacevo.records import Reason, Rejection, Stage
from tacevo.text import counted, printable

#: Characters of an answer that a warning shows, at most.
_SHOWN = 100


class UsableAnswers:
    """Counts answers that trained, generation by generation, and generations in a row without one.

    Args:
        most: generations in a row without a usable answer after which a search stops; None for no limit.
    """

    def __init__(self, most: int | None) -> None:
        self._most = most
        #: The message about each of the last generations in a row without a usable answer.
        self._row: list[str] = []
        self._begin()

    def _begin(self) -> None:
        self._asked = 0
        #: Rejected answers by where and why, and the first of each.
        self._rejected = Counter[tuple[Stage, Reason]]()
        self._samples: dict[tuple[Stage, Reason], str] = {}

    def take(self, outcome: Outcome) -> None:
        """Count what became of an answer; the baseline and given networks are none."""
        if outcome.completion is None:
            return
        self._asked += 1
        if isinstance(outcome.result, Rejection):
            why = outcome.result.stage, outcome.result.reason
            self._rejected[why] += 1
            told = f"{outcome.proposal.id} ({printable(outcome.result.detail)})"
            self._samples.setdefault(why, f"{told}, which begins {_beginning(outcome.completion.text)}")

    def close(self, generation: int) -> str | None:
        """End a generation; return a warning where it had answers and none could be used."""
        asked, rejected, samples = self._asked, self._rejected, self._samples
        self._begin()
        if not asked or rejected.total() < asked:
            self._row = []
            return None
        ((stage, reason), count), *_ = rejected.most_common(1)
        often = f"most often {stage}: {reason} ({count} of {asked}), as {samples[stage, reason]}"
        warning = f"generation {generation}: not one of {counted(asked, 'answer')} could be used; {often}"
        self._row.append(warning)
        return warning

    def check(self) -> None:
        """Stop a search that got no usable answer for too long.

        Raises:
            LLMError: so many generations in a row had none.
        """
        if self._most is not None and len(self._row) >= self._most:
            raise LLMError(
                self._row[-1],
                place="search.stop_after_unusable",
                expected=f"a usable answer within {counted(self._most, 'generation')}",
                remedy="look at the answers in candidates/ and at the model; the same command goes on from here, and "
                "with search.stop_after_unusable=null whatever comes",
            )


def _beginning(answer: str) -> str:
    """Return the first line of an answer that is not blank, printable, quoted and cut."""
    lines = (" ".join(line.split()) for line in answer[: 100 * _SHOWN].splitlines())
    first = printable(next((line for line in lines if line), ""))
    return f'"{first}"' if len(first) <= _SHOWN else f'"{first[:_SHOWN]}..."'
