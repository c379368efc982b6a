"""`tacevo search --estimate`: requests, tokens, cost and hours of a search, before any call and without a key.

The requests of generation 0 are those that a search would send. Later ones depend on what the search finds: a mutation
quotes one network, a crossover two, and their length is a guess. `llm.budget_usd` is the limit.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacevo.choices import AnswerForm, Carrier, ModelChoice, Thinking
from tacevo.config.schema import UNCHOSEN, LLMConfig, RunConfig
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.costs import Spending, dollars, spending_on, total
from tacevo.errors import TacevoError
from tacevo.evolution.prompts import crossover_text, mutation_text
from tacevo.evolution.proposals import plan_initial
from tacevo.llm.prices import PriceTable, likely_tokens, line_to_add
from tacevo.records import DataFacts, Delivery, Mode, Request, Setting, Task, to_json
from tacevo.runs.datasets import source_of
from tacevo.runs.decisions import Decisions, Parts
from tacevo.runs.pace import Measure, Pace, Saving, growth, measure, part_saved, training_images, trainings
from tacevo.runs.progress import LONG, told_saving
from tacevo.runs.providers import asks_elsewhere, prices_of, provider_settings
from tacevo.runs.wiring import build_settings
from tacevo.storage.canonical import content_hash
from tacevo.storage.listing import scan
from tacevo.storage.store import Store
from tacevo.text import counted, listed, table

#: The text that a user reads while a pace is measured: it takes some 80 s of a processor for images of 256 px.
MEASURING = (
    "measuring how fast this machine trains: one or two minutes where it is idle, more under load; Ctrl-C leaves the "
    "hours out"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """The estimate of what a search would ask for, as far as it is known before the search."""

    #: Requests of the whole search, without repairs.
    requests: int
    #: Requests of generation 0 whose answers are recorded already; they cost nothing.
    recorded: int
    #: The number of completions of this model in the store; they give the likely length of an answer.
    samples: int
    #: Tokens of thinking that are assumed before each answer; None where nothing says whether the model thinks.
    thinking_tokens: int | None
    #: Expected values, so not integers; thinking counts as output.
    input_tokens: float
    output_tokens: float
    #: Both by model, in the order of the configuration.
    by_model: tuple[tuple[float, float], ...]


def estimate(config: RunConfig) -> Estimate:
    """Count requests and tokens of a search, without sending a request.

    Likely is what recorded answers of the same model had on average; without any, networks and answers as long as the
    baseline, and four characters to a token.

    Raises:
        ConfigError: a file of the task cannot be used.
        StoreError: a recorded completion is damaged.
    """
    task = load_task(config, _facts(config))
    with Decisions(None) as decisions:
        first = _first_requests(config, task, Parts.of(config, decisions))
    store = Store(Path(config.store.root), "completions", Mode.record)
    search, initial = config.search, _initial(config)
    recorded = sum(store.read(to_json(request)) is not None for request in first)
    later = search.generations * search.candidates
    crossed = later * (1.0 - config.proposals.mutation_probability)
    mutation, crossover = _likely_inputs(task)
    asked = initial - recorded + later
    inputs = (asked - crossed) * mutation + crossed * crossover
    answer, thinking = likely_tokens(task.baseline), _likely_thinking(config)
    outputs = float(asked * min(answer + (thinking or 0), max(answer, config.llm.max_tokens)))
    samples, by_model, answered = 0, [], _recorded(config)
    for name, share in _shares(config.llm):
        spent, tokens = answered[name], (inputs, outputs)
        if spent.answers:
            tokens = asked * spent.input_tokens / spent.answers, asked * spent.output_tokens / spent.answers
        samples += spent.answers
        by_model.append((share * tokens[0], share * tokens[1]))
    return Estimate(
        requests=initial + later,
        recorded=recorded,
        samples=samples,
        thinking_tokens=thinking,
        input_tokens=math.fsum(tokens for tokens, _ in by_model),
        output_tokens=math.fsum(tokens for _, tokens in by_model),
        by_model=tuple(by_model),
    )


def _shares(llm: LLMConfig) -> list[tuple[str, float]]:
    """Return the likely share of each model in the requests: that of its weight; with a bandit, equal ones."""
    weighed = llm.models or ((llm.name, 1.0),)
    whole = math.fsum(weight for _, weight in weighed)
    return [(name, weight / whole) for name, weight in weighed]


def _initial(config: RunConfig) -> int:
    """Return how many requests generation 0 has: none where networks are given."""
    return 0 if config.search.networks else config.search.initial


def _first_requests(config: RunConfig, task: Task, parts: Parts) -> list[Request]:
    """Return the requests of generation 0."""
    settings, mutations = build_settings(config, parts), _initial(config)
    planned = plan_initial(task, settings, mutations=mutations, temperature=config.temperature.start)
    return [proposal.request for proposal in planned if proposal.request is not None]


def _facts(config: RunConfig) -> DataFacts:
    """Describe the data set as the requests name it; that the classes of a simulation have names needs no image."""
    if config.data.facts.is_looked_up:
        from tacevo.runs.table_answers import table_of

        return table_of(config).header.data
    source, facts = source_of(config), facts_without_data(config)
    names = getattr(source, "names", ())  # of a source that makes its images, and knows them before
    return replace(facts, names=names) if names else facts


def describe_cost(config: RunConfig) -> str:
    """Write down what a search asks for: requests, tokens, and the cost by model and delivery; nothing is measured."""
    estimated = estimate(config)
    delivered = config.llm.facts.deliveries
    basis = _basis(config, estimated)
    repairs = ", and no answer is sent back for repair" if config.proposals.repair_attempts else ""
    ends = ", and search.training_flops does not end the search early" if config.search.training_flops else ""
    header = ["input tokens", "output tokens", *(f"USD {each.value}" for each in delivered)]
    counts = [f"{tokens:,.0f}" for tokens in (estimated.input_tokens, estimated.output_tokens)]
    row = [*counts, *map(_dollars, _costs(config, estimated, delivered))]
    return "\n".join(
        [
            f"{estimated.requests} requests to {_asked(config.llm)}; the answers to {estimated.recorded} of generation "
            "0 are recorded already.",
            f"No request was sent. The table assumes that {basis}{repairs}{ends}.{_told(config)}",
            "",
            table(header, [row]),
            "",
            *_remarks(config),
        ]
    )


def _basis(config: RunConfig, estimated: Estimate) -> str:
    """Say what the tokens of an estimate assume of an answer."""
    if estimated.samples:
        of = "this model" if config.llm.models is None else "these models"
        return f"answers are like the mean of the {estimated.samples} recorded ones of {of} with these settings"
    basis = "networks are as long as the baseline, and a token has four characters"
    if not config.llm.facts.is_model or estimated.thinking_tokens == 0:
        return basis
    if estimated.thinking_tokens is None:
        return f"{basis}, and the model does not think before it answers, which would be billed as output"
    return f"{basis}, and the model thinks before each answer as long as it may: {estimated.thinking_tokens:,} tokens"


def _likely_thinking(config: RunConfig) -> int | None:
    """Return the most tokens that a model may think before an answer: 0 if it may not, None if nothing says whether."""
    llm = config.llm
    if llm.thinking is None and llm.thinking_tokens is None:
        return None
    if llm.thinking == Thinking.disabled:
        return 0
    return llm.max_tokens if llm.thinking == Thinking.adaptive else int(llm.thinking or llm.thinking_tokens or 0)


def describe_estimates(jobs: Sequence[tuple[str, RunConfig]], measure: Measure = measure) -> str:
    """Write the estimates of a sweep's jobs down, a row for each by its name, and their sum.

    Jobs that train alike share a measured pace. The hours are those of one job after the other.
    """
    delivered = list(dict.fromkeys(each for _, config in jobs for each in config.llm.facts.deliveries))
    paces: dict[str, Pace | None] = {}
    rows = [_figures(config, delivered, _seconds(config, measure, paces)) for _, config in jobs]
    sums = [None if None in column else sum(filter(None, column)) for column in zip(*rows, strict=True)]
    labels = [*(name for name, _ in jobs), f"all {counted(len(jobs), 'job')}"]
    header = ["job", "requests", "of them recorded", "input tokens", "output tokens"]
    header += [*(f"USD {each.value}" for each in delivered), "hours"]
    cells = [[label, *_cells(row)] for label, row in zip(labels, [*rows, sums], strict=True)]
    return "\n".join(
        [
            table(header, cells, right=range(1, len(header))),
            "",
            "No request was sent. Each row assumes what `tacevo search --estimate` says of that job by itself. Equal "
            "requests, as those of generation 0 of one seed, are asked once, so all jobs may ask for less than that.",
            "Hours: one job after the other, on machines like this one.",
        ]
    )


def _asked(llm: LLMConfig) -> str:
    """Name the models that are asked; several with their shares."""
    if llm.models is None:
        return llm.model
    shares = listed(f"{name} {share:.0%}" for name, share in _shares(llm))
    return f"{shares}, of which a bandit will make others" if llm.choice is ModelChoice.bandit else shares


def _told(config: RunConfig) -> str:
    """Say what the table leaves out of requests and answers; empty where that is nothing."""
    prompts, left = config.prompts, []
    if prompts.tells:
        left.append("what prompts.tells adds to requests")
    if prompts.answer is AnswerForm.edit:
        left.append("what prompts.answer=edit saves of answers")
    return f" Not counted, unless recorded answers have it: {' and '.join(left)} (docs/llm.md)." if left else ""


def _figures(config: RunConfig, delivered: Sequence[Delivery], seconds: float | None) -> list[float | None]:
    """Return the figures of a job's row; None where one is not known."""
    estimated = estimate(config)
    usd = _costs(config, estimated, delivered)
    return [estimated.requests, estimated.recorded, estimated.input_tokens, estimated.output_tokens, *usd, seconds]


def _costs(config: RunConfig, estimated: Estimate, delivered: Sequence[Delivery]) -> list[float | None]:
    """Price the tokens for each delivery; None where the provider has none such, or its price is not known."""
    table, offered = prices_of(config.llm), config.llm.facts.deliveries
    usual = estimated.input_tokens / max(estimated.requests - estimated.recorded, 1)
    return [_cost(table, config.llm, estimated, each, usual) if each in offered else None for each in delivered]


def _cost(table: PriceTable, llm: LLMConfig, estimated: Estimate, delivery: Delivery, usual: float) -> float | None:
    """Price the tokens of every model; None where the price of one is not known. `usual` is how long a prompt is."""
    costs = []
    for name, (read, written) in zip(llm.names, estimated.by_model, strict=True):
        price = table.price(name, delivery)
        if price is None:
            return None
        costs.append(price.of_prompt(usual).cost(read, written))
    return math.fsum(costs)


def _seconds(config: RunConfig, measure: Measure, paces: dict[str, Pace | None]) -> float | None:
    """Return the seconds of a job's trainings, None where they are not known; a pace is measured once."""
    if config.data.facts.is_looked_up:
        return 0.0
    alike = (config.task, config.data, config.training, config.executor, config.numerics, config.gate, config.sandbox)
    key = content_hash([to_json(each) for each in alike])
    try:
        if key not in paces:
            paces[key] = None
            paces[key] = measure(config)
        pace = paces[key]
        return None if pace is None else pace.seconds(config, training_images(config))
    except TacevoError:
        return None


def _cells(row: Sequence[float | None]) -> list[str]:
    """Write such figures down."""
    *tokens, last = row
    counts = [f"{value:,.0f}" for value in tokens[:4] if value is not None]
    return [*counts, *map(_dollars, tokens[4:]), "unknown" if last is None else _hours(last)]


def _dollars(amount: float | None) -> str:
    return "unknown" if amount is None else dollars(amount)


def describe_time(config: RunConfig, measure: Measure = measure, saving: Saving = part_saved) -> str:
    """Measure how long the trainings take on this machine, and say what that assumes; or why it is not known."""
    if config.data.facts.is_looked_up:
        return "hours: none, because nothing is trained: evaluations are looked up in the table."
    try:
        images, pace = training_images(config), measure(config)
    except TacevoError as error:
        return f"hours: not measured ({error})"
    training, workers, took = config.training, config.executor.workers, pace.seconds(config, images)
    busy = f"The machine was busy: {pace.load:.1f} processes wanted each core. Idle, it is faster."
    where = "this machine" if config.executor.is_here else "machines like this one"
    size = f"{images:,} images of {config.data.image_size} px"
    rate = f"{pace.images_per_second:,.{0 if pace.images_per_second >= 100 else 1}f}"
    lines = [
        f"hours: {_hours(took)} for {trainings(config):,} trainings of "
        f"{counted(training.epochs, 'epoch')} of {size}, with executor.workers={workers} on {where}.",
        f"Measured now, on noise: {counted(pace.at_once, 'baseline')} at once, {rate} images/s in all; "
        f"{pace.start:.2g} s to start a training, {pace.gate:.2g} s in the gate.",
        f"The hours assume that a candidate takes {growth(config):.2g} times the baseline's time, as the published "
        "searches suggest; that each is admitted and trained; and that the machine stays as busy as it is.",
        "Waiting for answers is not counted, nor is making the data set.",
        *([busy] if pace.load >= 1 else []),
        *(told_saving(saving(config, images), took) if took > LONG else []),
    ]
    return "\n".join(lines)


def _hours(seconds: float) -> str:
    hours = seconds / 3600
    return f"about {hours:.2g}" if hours < 10 else f"about {hours:,.0f}"


def _likely_inputs(task: Task) -> tuple[int, int]:
    """Return the likely tokens of a mutation with the longest instruction, and of a crossover, both of the baseline."""
    longest = max((instruction.text for instruction in task.instructions), key=len)
    texts = mutation_text(task.baseline, longest), crossover_text(task.baseline, task.baseline, task.crossover)
    system = likely_tokens(task.system)
    mutation, crossover = (system + likely_tokens(text) for text in texts)
    return mutation, crossover


def _recorded(config: RunConfig) -> dict[str, Spending]:
    """Add up by model the recorded answers whose tokens are known, with the effort and the thinking of a configuration.

    Raises:
        StoreError: an entry of the store is damaged.
    """
    chosen = _effort_and_thinking(dict(provider_settings(config.llm)))
    efforts = {*config.temperature.efforts} if config.temperature.carrier is Carrier.effort else {chosen[0]}
    spent: dict[str, list[Spending]] = {name: [] for name in config.llm.names}
    for entry in scan(Path(config.store.root), ("completions",)):
        if entry.problem is not None:
            raise entry.problem
        effort, thinking = _effort_and_thinking(entry.settings)
        is_alike = entry.model in spent and effort in efforts and thinking == chosen[1]
        if is_alike and entry.completion is not None and entry.completion.tokens is not None:
            spent[str(entry.model)].append(spending_on([entry.completion]))
    return {name: total(each) for name, each in spent.items()}


def _effort_and_thinking(settings: Mapping[str, Setting]) -> list[Setting | None]:
    return [settings.get("effort"), settings.get("thinking", settings.get("thinking_tokens"))]


def _unpriced(config: RunConfig, models: Sequence[str]) -> str:
    """Say of which models a price table lacks the prices, and the very lines that it needs."""
    table, lines = config.llm.prices, listed(f"`{line_to_add(name)}`" for name in models)
    line = f"the line {lines}" if len(models) == 1 else f"the lines {lines}"
    if asks_elsewhere(config.llm) and table == LLMConfig.prices:
        return f"{table} is not about other servers: name a table of your own by llm.prices=FILE, with {line}"
    of = "this model" if config.llm.models is None else listed(models)
    return f"{table} lacks the price of {of}: add {line} below `models:`"


def _remarks(config: RunConfig) -> Sequence[str]:
    """Return the date of the prices, the delivery and budget of this run, and when the model is retired."""
    prices = prices_of(config.llm)
    found = [prices.price(name, Delivery.direct) for name in config.llm.names]
    lacking = [name for name, price in zip(config.llm.names, found, strict=True) if price is None]
    known = f"prices of {listed(sorted({price.dated for price in found if price is not None}))}"
    if lacking:
        known = _unpriced(config, lacking)
    if config.llm.model == UNCHOSEN:
        known = "the cost is that of the model: add llm=anthropic, or llm=openai llm.model=NAME"
    budget = "no limit" if config.llm.budget_usd is None else f"{config.llm.budget_usd:g} USD"
    ends = [(name, prices.retirement(name)) for name in config.llm.names]
    setting = "llm.model" if config.llm.models is None else "llm.models"
    gone = [f"{name} is not served from {day} on; set {setting} to another" for name, day in ends if day is not None]
    return [f"{known}; this run: llm.delivery={config.llm.delivery}, llm.budget_usd: {budget}", *gone]
