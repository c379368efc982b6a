"""Promise: a budget is never exceeded; what was asked is answered and kept, and a larger budget goes on from there."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from asked import request as asking
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from tacevo.errors import BudgetError, TransportError
from tacevo.evolution.development import LLM
from tacevo.llm.budget import Account, BudgetedLLM
from tacevo.llm.prices import worst_case
from tacevo.llm.recording import RecordingLLM
from tacevo.parts.provider import Keep
from tacevo.records import Completion, Mode, Price, Request
from tacevo.storage.store import Store

#: A dollar a token, so that amounts are tokens.
PRICE = Price(input_usd=1e6, output_usd=1e6, dated="2026-11-21")


def request(number: int, max_tokens: int = 100) -> Request:
    """Make a request; its worst case is 128 + 1 + `max_tokens` dollars."""
    return replace(asking(str(number), draw=number), system="", max_tokens=max_tokens)


def answer(tokens: int, price: Price | None = None) -> Completion:
    """Make an answer of so many tokens, of which one is output."""
    return Completion(
        text="ok", model="m", stop_reason="end_turn", input_tokens=tokens - 1, output_tokens=1, price=price
    )


class FakeLLM:
    """Answers with so many tokens each, the last request first; may fail at one of them."""

    def __init__(self, tokens: int, fails_at: int | None = None) -> None:
        self.rounds: list[int] = []
        self._tokens = tokens
        self._fails_at = fails_at

    def complete(self, requests: Sequence[Request], keep: Keep) -> Iterator[tuple[int, Completion]]:
        """Answer in reverse."""
        self.rounds.append(len(requests))
        for position in reversed(range(len(requests))):
            if requests[position].draw == self._fails_at:
                raise TransportError("no network")
            yield position, keep(requests[position], answer(self._tokens))


def budgeted(inner: FakeLLM, limit: float, root: Path) -> LLM:
    """Put store and budget before a fake, as a run does."""
    account = Account(lambda request, completion: PRICE)
    within = BudgetedLLM(inner, account, limit=limit, prices=PRICES)
    store = Store(root, "completions", Mode.record)
    return RecordingLLM(within, store, price=lambda request, completion: PRICE, count=account.add)


def ask(llm: LLM, requests: Sequence[Request]) -> set[int]:
    """Ask, and return the positions of the answers."""
    return {position for position, _ in llm.complete(requests)}


REQUESTS = [request(number) for number in range(6)]
PRICES = {REQUESTS[0].model: PRICE}
WORST = worst_case(PRICE, REQUESTS[0])


@pytest.mark.parametrize(("fit", "rounds"), [(6, [6]), (3, [3, 2, 1])])
def test_budget_asks_in_as_few_rounds_as_it_allows(fit: int, rounds: list[int], tmp_path: Path) -> None:
    """All at once where so many fit; else what answers left over of their worst case lets further ones through."""
    inner = FakeLLM(tokens=20)
    assert ask(budgeted(inner, fit * WORST, tmp_path), REQUESTS) == set(range(6))
    assert inner.rounds == rounds


def test_exhausted_budget_keeps_what_was_asked_and_says_how_to_go_on(tmp_path: Path) -> None:
    """Two fit at their worst; both are answered and kept, and the message names the key, the cost and the way on."""
    llm = budgeted(FakeLLM(tokens=int(WORST)), 2.5 * WORST, tmp_path)
    answered: list[int] = []
    got = "458.00 USD for the run's answers, and up to 229.00 USD for the next of 4 open requests"
    with refused(BudgetError, place="llm.budget_usd", expected="572.5 USD", got=got, remedy="a larger llm.budget_usd"):
        answered.extend(position for position, _ in llm.complete(REQUESTS))
    assert sorted(answered) == [0, 1]
    assert len(list(tmp_path.rglob("*.json"))) == 2


def test_larger_budget_asks_only_for_the_rest(tmp_path: Path) -> None:
    """A later run counts what is recorded, and pays for nothing twice."""
    with pytest.raises(BudgetError):
        ask(budgeted(FakeLLM(tokens=int(WORST)), 2 * WORST, tmp_path), REQUESTS)
    later = FakeLLM(tokens=int(WORST))
    assert ask(budgeted(later, 6 * WORST, tmp_path), REQUESTS) == set(range(6))
    assert later.rounds == [4]


def test_recorded_answers_count(tmp_path: Path) -> None:
    """The same budget again stops at the same place, and asks nobody."""
    for _ in range(2):
        inner = FakeLLM(tokens=int(WORST))
        with refused(BudgetError, got="458.00 USD for the run's answers"):
            ask(budgeted(inner, 2.5 * WORST, tmp_path), REQUESTS)
    assert inner.rounds == []


def test_recorded_answers_come_whatever_the_budget(tmp_path: Path) -> None:
    """A budget stops new requests; what is paid for is read, even with nothing left."""
    ask(budgeted(FakeLLM(tokens=20), 6 * WORST, tmp_path), REQUESTS)
    assert ask(budgeted(FakeLLM(tokens=20), 0.0, tmp_path), REQUESTS) == set(range(6))


def test_generations_share_one_budget(tmp_path: Path) -> None:
    """The account is the run's, not the round's."""
    llm = budgeted(FakeLLM(tokens=int(WORST)), 3 * WORST, tmp_path)
    assert ask(llm, REQUESTS[:2]) == {0, 1}
    with pytest.raises(BudgetError):
        ask(llm, REQUESTS[2:])
    assert len(list(tmp_path.rglob("*.json"))) == 3


def test_request_is_counted_once(tmp_path: Path) -> None:
    """The same request again, and twice in one round, is one answer and one cost."""
    llm = budgeted(FakeLLM(tokens=int(WORST)), 2 * WORST, tmp_path)
    assert ask(llm, [REQUESTS[0], REQUESTS[0]]) == {0, 1}
    assert ask(llm, [REQUESTS[0], REQUESTS[1]]) == {0, 1}


def test_failure_of_the_provider_ends_the_rounds(tmp_path: Path) -> None:
    """After a failure no further round begins."""
    inner = FakeLLM(tokens=20, fails_at=0)
    with pytest.raises(TransportError, match="no network"):
        ask(budgeted(inner, 2 * WORST, tmp_path), REQUESTS)
    assert inner.rounds == [2]


def test_answer_recorded_without_a_price_counts_by_todays() -> None:
    """Answers of a store that kept no prices yet are not free."""
    account = Account(lambda request, completion: PRICE)
    account.add(REQUESTS[0], answer(50))
    account.add(REQUESTS[1], answer(50, price=Price(input_usd=2e6, output_usd=2e6, dated="2025-01-01")))
    assert account.spent == 150


@given(limits=st.floats(0, 3_000), sizes=st.lists(st.integers(1, 300), max_size=12), part=st.floats(0, 1))
def test_limit_is_never_exceeded(limits: float, sizes: list[int], part: float) -> None:
    """Whatever the answers cost up to their worst case, the sum stays within the limit."""
    asked = [request(number, size) for number, size in enumerate(sizes)]

    class Partly:
        def complete(self, requests: Sequence[Request], keep: Keep) -> Iterator[tuple[int, Completion]]:
            """Answer with a part of the worst case."""
            for position, each in enumerate(requests):
                yield position, keep(each, answer(max(1, int(part * worst_case(PRICE, each)))))

    account = Account(lambda request, completion: PRICE)
    answered = 0
    try:
        for position, completion in BudgetedLLM(Partly(), account, limit=limits, prices=PRICES).complete(asked):
            account.add(asked[position], completion)
            answered += 1
    except BudgetError:
        assert account.spent + worst_case(PRICE, asked[answered]) > limits
    else:
        assert answered == len(asked)
    assert account.spent <= limits


@pytest.mark.parametrize("unknown", [replace(answer(9), input_tokens=None), replace(answer(9, PRICE), cache_read=5)])
def test_answer_of_unknown_cost_counts_as_the_most_that_it_can_cost(
    unknown: Completion, caplog: pytest.LogCaptureFixture
) -> None:
    """Neither as nothing nor in silence: the limit holds, and the user hears of it once."""
    account = Account(lambda request, completion: PRICE)
    for asked in REQUESTS[:2]:
        account.add(asked, unknown)
    assert account.spent == 2 * WORST
    assert len(caplog.records) == 1


def test_worst_case_is_that_of_the_model_that_is_asked(tmp_path: Path) -> None:
    """Of several models each has a price of its own: what fits of a cheap one does not fit of a dear one."""
    dear = replace(PRICE, input_usd=2e6, output_usd=2e6)
    cheap, other = request(1), replace(request(2), model="dear")
    limit = worst_case(PRICE, cheap)
    for asked, fits in ((cheap, True), (other, False)):
        inner = FakeLLM(1)
        account = Account(lambda request, completion: PRICE)
        within = BudgetedLLM(inner, account, limit=limit, prices={cheap.model: PRICE, other.model: dear})
        if fits:
            assert dict(within.complete([asked]))[0].text == "ok"
        else:
            with refused(BudgetError, place="llm.budget_usd"):
                list(within.complete([asked]))
