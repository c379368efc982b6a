"""A limit on what a run's answers may cost.

What it promises: no request is sent whose worst case, together with those in flight and with everything that the
run's answers have cost, exceeds the limit; so the limit is never exceeded. What is in flight when the limit is near is
waited for and recorded. An answer counts with its recorded price, also one that another run recorded, so a stopped
run continues with the same account; one whose cost is not known, because its tokens are not, counts with its worst
case. What it does not: count what a provider bills for answers that never arrived.
"""

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace

from tacevo.costs import dollars
from tacevo.errors import BudgetError
from tacevo.llm.prices import worst_case
from tacevo.llm.recording import unkept
from tacevo.parts.provider import Keep, Provider
from tacevo.records import Completion, Price, Request, to_json
from tacevo.storage.canonical import content_hash

_LOG = logging.getLogger(__name__)


@dataclass(slots=True)
class Account:
    """The cost of the answers of one run, each request counted once; of a request only its hash is kept."""

    #: Prices an answer that was recorded without one.
    price_of: Callable[[Request, Completion], Price | None]
    costs: dict[str, float] = field(default_factory=dict)
    warned: bool = False

    @property
    def spent(self) -> float:
        """The sum, in US dollars."""
        return math.fsum(self.costs.values())

    def add(self, request: Request, completion: Completion) -> None:
        """Count an answer; the second time it is seen changes nothing."""
        price = completion.price or self.price_of(request, completion)
        if price is None:  # never of a model that is asked with a budget
            return
        cost = replace(completion, price=price).cost
        if cost is None:
            cost = worst_case(price, request)
            if not self.warned:
                _LOG.warning("llm.budget_usd: what some answers cost is not known; each counts with its worst case")
            self.warned = True
        self.costs[content_hash(to_json(request))] = cost


@dataclass(slots=True)
class BudgetedLLM:
    """Lets requests through to a provider as long as the account allows.

    All that fit go at once. Answers cost less than their worst case, so what is left over then fits more, and so on
    until not even one fits.
    """

    inner: Provider
    #: The cost of the run's answers so far; `RecordingLLM` adds each answer before it takes the next.
    account: Account
    _: KW_ONLY
    #: The most that the answers may cost, in US dollars.
    limit: float
    #: The prices of the models that are asked, by name, for the worst case.
    prices: Mapping[str, Price]

    def complete(self, requests: Sequence[Request], keep: Keep = unkept) -> Iterator[tuple[int, Completion]]:
        """Answer requests, in as few rounds as the budget allows (see `tacevo.parts.provider.Provider`).

        Raises:
            BudgetError: the next request could exceed the limit; the answers to those before it were yielded.
        """
        done = 0
        while done < len(requests):
            fitting = self._fitting(requests[done:])
            if not fitting:
                raise self._exhausted(requests[done], len(requests) - done)
            for index, completion in self.inner.complete(fitting, keep):
                yield done + index, completion
            done += len(fitting)

    def _fitting(self, requests: Sequence[Request]) -> list[Request]:
        """Take requests from the front as long as their worst cases fit what is left."""
        left = self.limit - self.account.spent
        fitting = []
        for request in requests:
            left -= self._worst_case(request)
            if left < 0:
                break
            fitting.append(request)
        return fitting

    def _worst_case(self, request: Request) -> float:
        return worst_case(self.prices[request.model], request)

    def _exhausted(self, request: Request, waiting: int) -> BudgetError:
        spent, next_ = dollars(self.account.spent), dollars(self._worst_case(request))
        return BudgetError(
            f"{spent} USD for the run's answers, and up to {next_} USD for the next of {waiting} open requests",
            place="llm.budget_usd",
            expected=f"costs up to {self.limit:g} USD",
            remedy="repeat the command with a larger llm.budget_usd to continue; the answers so far are recorded",
        )
