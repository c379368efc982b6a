"""`tacevo search --estimate`: requests, tokens and cost of a search, before any call and without a key.

The requests of generation 0 are written out, as a search would write them. Those of later generations depend on what is
found: a mutation holds one network, a crossover two, and how long these are is a guess or, at most, a bound.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacevo.config.schema import RunConfig, deliveries
from tacevo.config.tasks import facts_without_data, load_task
from tacevo.costs import dollars, spending_on
from tacevo.llm.prices import PriceTable, likely_tokens, most_input_tokens
from tacevo.records import Completion, Delivery, Message, Mode, Request, to_json
from tacevo.runs.providers import load_prices
from tacevo.runs.wiring import build_settings
from tacevo.search.proposals import Settings, Task, crossover_text, plan_initial
from tacevo.storage.listing import scan
from tacevo.storage.store import Store
from tacevo.text import table

#: Tokens of a turn that sends an answer back; the gate keeps its reasons to a line.
_MOST_OF_A_REASON = 2_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Tokens:
    """Input and output tokens of some requests; expected values, so no whole numbers."""

    input: float
    output: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """What a search would ask for, as far as that can be said before it."""

    #: Requests of the whole search, without repairs.
    requests: int
    #: Requests of generation 0 whose answers are recorded already; they cost nothing.
    recorded: int
    #: Completions of this model in the store, from which the likely length of an answer is taken; 0 for none.
    samples: int
    likely: Tokens
    most: Tokens


def estimate(config: RunConfig) -> Estimate:
    """Count requests and tokens of a search; nobody is asked.

    Likely is what recorded answers of the same model had on average; without any, networks and answers as long as the
    baseline, and four characters to a token. The most is every byte a token, every answer at `llm.max_tokens` and
    every parent such an answer; a request that may be repaired counts once more for every repair, with its
    conversation.

    Raises:
        ConfigError: a file of the task cannot be used.
        StoreError: a recorded completion is damaged.
    """
    task = load_task(config, facts_without_data(config))
    settings = build_settings(config)
    store = Store(Path(config.store.root), "completions", Mode.record)
    search = config.search
    first = _first_requests(task, settings, search.initial, config.temperature.start)
    recorded = sum(store.read(to_json(request)) is not None for request in first)
    later = search.generations * search.candidates
    crossed = later * (1.0 - config.proposals.mutation_probability)
    mutation, crossover = _typical(task, settings, config.temperature.start)
    rounds = 1 + config.proposals.repair_attempts
    asked = search.initial - recorded + later
    spent = spending_on(_answers(Path(config.store.root), config.llm.model))
    inputs = (asked - crossed) * _likely_input(mutation) + crossed * _likely_input(crossover)
    likely = Tokens(input=inputs, output=float(asked * likely_tokens(task.baseline)))
    if spent.answers:
        means = (asked * tokens / spent.answers for tokens in (spent.input_tokens, spent.output_tokens))
        likely = Tokens(input=next(means), output=next(means))
    return Estimate(
        requests=search.initial + later,
        recorded=recorded,
        samples=spent.answers,
        likely=likely,
        most=_most(asked, task, mutation=mutation, crossover=crossover, rounds=rounds),
    )


def describe(config: RunConfig) -> str:
    """Write an estimate down: requests, tokens, and the cost by model and delivery."""
    found = estimate(config)
    prices = load_prices(config.llm.prices)
    basis = "networks as long as the baseline, four characters to a token"
    if found.samples:
        basis = f"like the mean of {found.samples} recorded answers of this model"
    repairs = config.proposals.repair_attempts
    none, every = (", no repair", f", each repaired {repairs} times") if repairs else ("", "")
    lines = [
        f"{found.requests} requests to {config.llm.model}, {found.recorded} of generation 0 recorded already; nothing "
        "was asked.",
        f"likely: {basis}{none}; at most: every byte a token, every answer at llm.max_tokens{every}.",
    ]
    rows = [
        [name, f"{tokens.input:,.0f}", f"{tokens.output:,.0f}", *_costs(config, prices, tokens)]
        for name, tokens in (("likely", found.likely), ("at most", found.most))
    ]
    header = ["", "input tokens", "output tokens", *(f"USD {each.value}" for each in deliveries(config.llm.provider))]
    return "\n".join([*lines, "", table(header, rows), "", *_remarks(config, prices)])


def _first_requests(task: Task, settings: Settings, mutations: int, temperature: float) -> list[Request]:
    proposals = plan_initial(task, settings, mutations=mutations, temperature=temperature)
    return [proposal.request for proposal in proposals if proposal.request is not None]


def _typical(task: Task, settings: Settings, temperature: float) -> tuple[Request, Request]:
    """Write a mutation with the longest instruction, and a crossover, both of the baseline."""
    longest = max(task.instructions, key=lambda instruction: len(instruction.text))
    (mutation,) = _first_requests(replace(task, instructions=(longest,)), settings, 1, temperature)
    text = crossover_text(task.baseline, task.baseline, task.crossover)
    return mutation, replace(mutation, messages=(Message(role="user", content=text),))


def _likely_input(request: Request) -> int:
    return likely_tokens(request.system) + sum(likely_tokens(turn.content) for turn in request.messages)


def _most(asked: int, task: Task, *, mutation: Request, crossover: Request, rounds: int) -> Tokens:
    """Bound the tokens of requests and their repairs; a parent is the baseline or part of an earlier answer."""
    answer = mutation.max_tokens
    longer = max(0, answer - len(task.baseline.encode()))
    prompt = max(most_input_tokens(mutation) + longer, most_input_tokens(crossover) + 2 * longer)
    inputs = sum(prompt + earlier * (answer + _MOST_OF_A_REASON) for earlier in range(rounds))
    return Tokens(input=asked * inputs, output=asked * rounds * answer)


def _answers(root: Path, model: str) -> Iterator[Completion]:
    """Read the recorded answers to requests of a model, one after the other: a store may be larger than the memory."""
    for found in scan(root, ("completions",)):
        if found.problem is not None:
            raise found.problem
        if found.model == model and found.completion is not None:
            yield found.completion


def _costs(config: RunConfig, prices: PriceTable, tokens: Tokens) -> list[str]:
    """Price tokens for each delivery that the provider has."""
    found = [prices.price(config.llm.model, delivery) for delivery in deliveries(config.llm.provider)]
    return ["unknown" if price is None else dollars(price.cost(tokens.input, tokens.output)) for price in found]


def _remarks(config: RunConfig, prices: PriceTable) -> Sequence[str]:
    """Say whose prices these are, what llm.delivery and llm.budget_usd are, and when the model is retired."""
    price = prices.price(config.llm.model, Delivery.direct)
    known = f"prices of {price.dated}" if price is not None else f"{config.llm.prices} has no price of this model"
    budget = "no limit" if config.llm.budget_usd is None else f"{config.llm.budget_usd:g} USD"
    retired = prices.retirement(config.llm.model)
    gone = [] if retired is None else [f"{config.llm.model} is not served from {retired} on; set llm.model to another"]
    return [f"{known}; this run: llm.delivery={config.llm.delivery}, llm.budget_usd: {budget}", *gone]
