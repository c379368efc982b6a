"""Arms compared answer by answer: the same question, asked as two arms ask it.

Arms of one seed draw the parents, the instruction and the training seed of a slot by the same random streams. As long
as their archives are equal, which they are in the first generation after generation 0, a slot of one arm and that of
another ask the same of a model, but for what tells the arms apart. Two such answers are a pair, and the difference of
their losses has neither the parent's nor the instruction's share of the noise in it.

Where a search asks each question several times (`proposals.answers`), how far its answers lie apart says how diverse a
model is: by what a temperature changes first.
"""

import contextlib
import io
import itertools
import math
import tokenize
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import fmean
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.stats import wilcoxon

from analysis.statistics.effects import mean_with_interval
from analysis.statistics.tests import holm, sign_p
from tacevo.errors import ConfigError, RunError, StoreError
from tacevo.evolution.lines import CandidateLine
from tacevo.gate.likeness import is_same_network
from tacevo.records import Completion, Request, token_count
from tacevo.results.run import RecordedRun
from tacevo.results.sweep import REFERENCE, RecordedSweep
from tacevo.rounding import rounded
from tacevo.storage.canonical import content_hash
from tacevo.storage.store import Store
from tacevo.text import listed
from tacevo.typed import convert

T = TypeVar("T", bound=Hashable)

#: The generation whose slots are compared: the only one before which the archives of all arms are equal.
GENERATION = 1

#: The columns of the answers, one a row: its arm, seed, slot and the number of its question; by what parents and
#: instruction it is paired; whether it trained, and the logarithm of its loss; characters of what was asked and of what
#: was answered, and tokens where the server counted them. Missing where it did not train, or its store is elsewhere.
ANSWERS = {
    "arm": "str",
    "seed": "int64",
    "slot": "int64",
    "question": "int64",
    "asked": "object",
    "trained": "bool",
    "loss": "float64",
    **dict.fromkeys(("input_characters", "output_characters", "input_tokens", "output_tokens"), "float64"),
}

#: The columns of the comparison, an arm a row: pairs with the reference, and the questions with a pair of which both
#: trained; the factor of the loss (below 1 lower than the reference's) with its interval of 95 %, p of a factor of 1
#: before and after Holm's correction; the deviation of a question's difference of logarithms; the share of its answers
#: that trained, p of the questions of which one arm trained more, and Holm's; mean characters and tokens.
ARMS = (
    {"pairs": "int64", "questions": "int64"}
    | dict.fromkeys(("factor", "factor_low", "factor_high", "p", "p_holm", "deviation"), "float64")
    | dict.fromkeys(("trained", "trained_p", "trained_p_holm"), "float64")
    | dict.fromkeys(("input_characters", "output_characters", "input_tokens", "output_tokens"), "float64")
)

#: The columns of the diversity of answers to one question, an arm a row: questions of which two answers or more
#: trained, in the reference, too; the mean distances of two answers' texts and of their operations, each in [0, 1],
#: with the difference from the reference, p and Holm's p; and the share of pairs of answers that are one network.
DIVERSITY = {"questions": "int64"} | {
    f"{measure}{end}": "float64"
    for measure in ("text", "operations", "equal")
    for end in ("", "_difference", "_difference_low", "_difference_high", "_p", "_p_holm")
}

#: The least pairs, or questions, from which an interval and a p are computed.
LEAST = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pairs:
    """A sweep whose arms are compared answer by answer."""

    reference: str
    #: Whether the parents of a pair are other networks, at the same places of generation 0.
    other_parents: bool
    #: One row an answer (`ANSWERS`).
    answers: pd.DataFrame
    #: The arms, the reference first (`ARMS`).
    arms: pd.DataFrame
    #: The arms, the reference first (`DIVERSITY`); None where each question was asked once.
    diversity: pd.DataFrame | None
    #: Slots of arms that ask another question than the reference's, or that the reference does not have.
    unpaired: Mapping[str, int]
    #: Slots of arms whose request is the reference's, so that both have one recorded answer.
    shared: Mapping[str, int]


@dataclass(frozen=True, kw_only=True)
class _Answer:
    """One answer of a model."""

    arm: str
    seed: int
    line: CandidateLine
    run: RecordedRun
    question: int
    #: Its operator, the sources of its parents, or their ids where these stand for other networks, and its instruction.
    asked: tuple[Hashable, ...]

    @property
    def place(self) -> tuple[int, int]:
        return self.seed, self.line.slot

    @cached_property
    def source(self) -> str:
        """The text of its network."""
        assert self.line.source is not None
        return self.run.directory.read_source(self.line.id, self.line.source)

    @cached_property
    def bag(self) -> Counter[tuple[str, ...]]:
        return trigrams(self.source)


def compare_pairs(
    sweep: RecordedSweep,
    reference: str | None = None,
    *,
    other_parents: bool = False,
    operations: "Operations | None" = None,
) -> Pairs:
    """Compare the arms of a sweep answer by answer.

    Args:
        sweep: of two arms or more that have a seed in common.
        reference: the arm that others are compared with; None for the one that the sweep states, else `none`, or the
            first one where there is no such arm.
        other_parents: whether the answers in a slot are a pair where their parents are other networks with the same
            ids, as in arms that differ by `search.networks`.
        operations: returns what operations the trained candidates of a run call; None leaves that measure out.

    Raises:
        ConfigError: the sweep has no such arm with a finished run.
        RunError: no answer of another arm is to a question of the reference's.
    """
    arms = list(dict.fromkeys(one.job.arm for one in sweep.finished))
    wanted = reference or sweep.terms.reference or (REFERENCE if REFERENCE in arms else arms[0])
    if wanted not in arms:
        known = f"an arm with a finished search: {listed(arms)}"
        raise ConfigError(repr(wanted), place="reference", expected=known)
    answers = [
        answer
        for one in sweep.finished
        for answer in _answers_of(one.job.arm, one.job.seed, one.run, other_parents=other_parents)
    ]
    by_arm = {arm: {each.place: each for each in answers if each.arm == arm} for arm in (wanted, *arms)}
    pairs = {arm: list(_paired(own, by_arm[wanted])) for arm, own in by_arm.items()}
    if not any(both for arm, both in pairs.items() if arm != wanted):
        raise RunError(
            "no two answers to one question",
            place=str(sweep.path),
            expected=f"arms that ask what {wanted} asks in generation {GENERATION}: equal generations 0 and parents",
            remedy="`tacevo search -m experiment=pairs SETTING=A,B` makes such a sweep (docs/pairs.md)"
            + ("" if other_parents else "; --other-parents compares arms that differ by search.networks"),
        )
    lengths = _lengths(answers)
    measured = [_row(answer) | lengths.get(str(answer.line.request), {}) for answer in answers]
    frame = pd.DataFrame(measured, columns=list(ANSWERS)).astype(ANSWERS)
    rows = {arm: _comparison(frame[frame.arm == arm], pairs[arm] if arm != wanted else None) for arm in by_arm}
    _correct(rows, ["p"])
    _correct(rows, ["trained_p"])
    several = any(one.run.config.proposals.answers > 1 for one in sweep.finished)
    return Pairs(
        reference=wanted,
        other_parents=other_parents,
        answers=frame,
        arms=pd.DataFrame.from_dict(rows, orient="index", columns=list(ARMS)).astype(ARMS),
        diversity=_diversity(by_arm, wanted, operations) if several else None,
        unpaired=_counts(by_arm, wanted, lambda own, other: other is None or own.asked != other.asked),
        shared=_counts(by_arm, wanted, lambda own, other: other is not None and own.line.request == other.line.request),
    )


#: Returns the operations of a run's trained candidates by id: how often each calls which; None where not known.
Operations = Callable[[RecordedRun], Mapping[str, Counter[str]] | None]


def trigrams(source: str) -> Counter[tuple[str, ...]]:
    """Count the runs of three tokens of a Python text, without comments and layout; names count as they are spelt."""
    silent = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    read = tokenize.generate_tokens(io.StringIO(source).readline)
    words = [token.string for token in read if token.type not in silent]
    return Counter(zip(words, words[1:], words[2:], strict=False))


def distance(first: Counter[T], second: Counter[T]) -> float:
    """Return the distance of Jaccard of two bags: one less what they share of what either has, in [0, 1]."""
    either = (first | second).total()
    return 1 - (first & second).total() / either if either else 0.0


def _answers_of(arm: str, seed: int, run: RecordedRun, *, other_parents: bool) -> Iterator[_Answer]:
    sources = {line.id: line.source for line in run.candidates}
    for line in run.candidates:
        if line.generation == GENERATION and line.request is not None:
            parents = line.parents if other_parents else tuple(sources[parent] for parent in line.parents)
            asked = (line.operator, tuple(parents), line.prompt)
            question = line.slot // run.config.proposals.answers
            yield _Answer(arm=arm, seed=seed, line=line, run=run, question=question, asked=asked)


def _paired(
    own: Mapping[tuple[int, int], _Answer], others: Mapping[tuple[int, int], _Answer]
) -> Iterator[tuple[_Answer, _Answer]]:
    """Yield answers of two arms to one question; equal requests are one request, which has one answer in both."""
    for place, answer in own.items():
        other = others.get(place)
        if other is not None and other.asked == answer.asked and other.line.request != answer.line.request:
            yield answer, other


def _counts(
    by_arm: Mapping[str, Mapping[tuple[int, int], _Answer]], reference: str, counts: Callable[[_Answer, Any], bool]
) -> dict[str, int]:
    """Count by arm the answers that are so beside the reference's answer in their slot; only arms that have some."""
    found = {
        arm: sum(counts(answer, by_arm[reference].get(place)) for place, answer in own.items())
        for arm, own in by_arm.items()
        if arm != reference
    }
    return {arm: count for arm, count in found.items() if count}


def _row(answer: _Answer) -> dict[str, Any]:
    line, fitness = answer.line, answer.line.fitness
    return {
        "arm": answer.arm,
        "seed": answer.seed,
        "slot": line.slot,
        "question": answer.question,
        "asked": answer.asked,
        "trained": fitness is not None,
        "loss": None if fitness is None else _log(fitness),
    }


def _lengths(answers: Sequence[_Answer]) -> dict[str, dict[str, int | None]]:
    """Return by request how long it and its answer are, as far as the stores have them."""
    wanted = {str(answer.line.request) for answer in answers}
    found: dict[str, dict[str, int | None]] = {}
    for stores in dict.fromkeys(answer.run.stores for answer in answers):
        for entry in Store(stores, "completions").sound():
            name = content_hash(entry.request)
            if name in wanted and name not in found:
                with contextlib.suppress(StoreError):
                    found[name] = _length(
                        convert(Request, entry.request, place="request", error=StoreError),
                        convert(Completion, entry.answer, place="answer", error=StoreError),
                    )
    return found


def _length(request: Request, said: Completion) -> dict[str, int | None]:
    turns = [request.system, *(turn.content for turn in request.messages)]
    return {
        "input_characters": sum(map(len, turns)),
        "output_characters": len(said.text),
        "input_tokens": token_count(said.input_tokens) or None,
        "output_tokens": token_count(said.output_tokens) or None,
    }


def _comparison(own: pd.DataFrame, pairs: Sequence[tuple[_Answer, _Answer]] | None) -> dict[str, Any]:
    """Compare an arm with the reference, by its answers and its pairs; None for the reference itself."""
    means = own[["trained", *(name for name in ANSWERS if name.endswith(("characters", "tokens")))]].mean()
    row = {"pairs": len(own), "questions": 0, **means.dropna().to_dict()}
    if pairs is None:
        return row
    differences = _by_question(
        (own.asked, _log(own.line.fitness) - _log(other.line.fitness))
        for own, other in pairs
        if own.line.fitness is not None and other.line.fitness is not None
    )
    row |= {"pairs": len(pairs), "questions": len(differences)}
    if pairs:
        more = _by_question(
            (own.asked, float(own.line.fitness is not None) - float(other.line.fitness is not None))
            for own, other in pairs
        )
        row["trained_p"] = sign_p(sum(each > 0 for each in more), sum(each < 0 for each in more))
    if (found := _estimate(differences)) is not None:
        mean, low, high, p = found
        row |= {name: rounded(math.exp(value)) for name, value in zip(_FACTOR, (mean, low, high), strict=True)}
        row |= {"p": p, "deviation": rounded(float(np.std(differences, ddof=1)))}
    return row


_FACTOR = ("factor", "factor_low", "factor_high")


def _diversity(
    by_arm: Mapping[str, Mapping[tuple[int, int], _Answer]], reference: str, operations: Operations | None
) -> pd.DataFrame:
    """Measure how far the answers to one question lie apart, and compare each arm with the reference (`DIVERSITY`)."""
    measured = {arm: _distances(own.values(), operations) for arm, own in by_arm.items()}
    rows: dict[str, dict[str, float]] = {}
    for arm, questions in measured.items():
        common = [key for key in questions if key in measured[reference]]
        row: dict[str, float] = {"questions": len(common)}
        for measure in ("text", "operations", "equal"):
            both = [
                (questions[key][measure], measured[reference][key][measure])
                for key in common
                if measure in questions[key] and measure in measured[reference][key]
            ]
            own, others = zip(*both, strict=True) if both else ((), ())
            row |= {measure: rounded(fmean(own))} if own else {}
            if arm == reference or not own:
                continue
            if (found := _estimate(np.subtract(own, others))) is not None:
                ends = ("_difference", "_difference_low", "_difference_high", "_p")
                row |= {f"{measure}{end}": value for end, value in zip(ends, found, strict=True)}
        rows[arm] = row
    _correct(rows, ["text_p", "operations_p", "equal_p"])
    return pd.DataFrame.from_dict(rows, orient="index", columns=list(DIVERSITY)).astype(DIVERSITY)


def _distances(answers: Iterable[_Answer], operations: Operations | None) -> dict[Hashable, dict[str, float]]:
    """Return by question the mean distances of two of its answers that trained, where it has two or more."""
    questions: dict[Hashable, list[_Answer]] = {}
    for answer in answers:
        if answer.line.fitness is not None:
            questions.setdefault((answer.seed, answer.question, answer.asked), []).append(answer)
    called: dict[str, Mapping[str, Counter[str]] | None] = {}
    found: dict[Hashable, dict[str, float]] = {}
    for key, own in questions.items():
        two = list(itertools.combinations(own, 2))
        if not two:
            continue
        found[key] = {
            "text": fmean(distance(one.bag, other.bag) for one, other in two),
            "equal": fmean(is_same_network(one.source, other.source) for one, other in two),
        }
        run = own[0].run
        if run.digest not in called:
            called[run.digest] = None if operations is None else operations(run)
        bags = called[run.digest]
        if bags is not None:
            found[key]["operations"] = fmean(distance(bags[one.line.id], bags[other.line.id]) for one, other in two)
    return found


def _by_question(differences: Iterable[tuple[Hashable, float]]) -> list[float]:
    """Return the mean of each question, since several answers to one question are no draws of their own."""
    questions: dict[Hashable, list[float]] = {}
    for asked, value in differences:
        questions.setdefault(asked, []).append(value)
    return [fmean(values) for values in questions.values()]


def _estimate(differences: ArrayLike) -> tuple[float, float, float, float] | None:
    """Return the mean of paired differences, the ends of Student's interval, and the p of Wilcoxon's signed ranks."""
    values = np.asarray(differences, dtype=np.float64)
    if len(values) < LEAST:
        return None
    mean, low, high = mean_with_interval(values)
    p = float(wilcoxon(values).pvalue) if values.any() else 1.0
    return rounded(mean), rounded(low), rounded(high), rounded(p)


def _correct(rows: Mapping[str, dict[str, float]], names: Sequence[str]) -> None:
    """Put beside each p of some names that of Holm's correction over all of them."""
    known = [(row, name) for row in rows.values() for name in names if name in row]
    if known:
        for (row, name), corrected in zip(known, holm([row[name] for row, name in known]), strict=True):
            row[f"{name}_holm"] = corrected


def _log(loss: float | None) -> float:
    assert loss is not None
    return math.log(max(loss, _LOWEST))


#: A loss below it counts as this one, because 0 has no logarithm.
_LOWEST = 1e-9
