"""What a generation asks for: operator, parents, instruction and temperature.

Pure: `plan_initial` and `plan_generation` turn the state of a search into proposals, by named random streams.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np

from tacevo.choices import OperatorScope, ParentPolicy, PromptPolicy, SystemTurn, TemperatureRule
from tacevo.evolution.archive import Archive
from tacevo.evolution.prompts import (
    PromptArchive,
    crossover_text,
    draw_pool,
    draw_prompt,
    draw_weighted,
    mutation_text,
    sample_text,
)
from tacevo.randomness import derived_seed, stream
from tacevo.records import ChatMessage, Operator, Request, Setting, Task


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """An evaluated candidate, as later generations need it."""

    id: str
    source: str
    #: Validation loss; lower is better.
    fitness: float
    #: Forward FLOPs of one image in training mode.
    flops: int = 0
    #: The exact sum of its own curiosity and those of its mutation children, and how many these are together.
    curiosities: Fraction
    scores: int = 1
    #: What the surrogate sees of it (`tacevo.evolution.surrogate`); empty in a search without one.
    features: Mapping[str, float] = field(default_factory=dict)

    @property
    def curiosity(self) -> float:
        """The mean; the sum is rounded once, so that the order of its terms does not matter."""
        return float(self.curiosities) / self.scores

    def with_child(self, curiosity: float) -> "Candidate":
        """Return the candidate with the curiosity of one more mutation child."""
        return replace(self, curiosities=self.curiosities + Fraction(curiosity), scores=self.scores + 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The settings of the plan, from the configuration."""

    seed: int
    candidates: int
    mutation_probability: float
    parents: ParentPolicy
    best: int
    prompts: PromptPolicy
    #: Half-width of the uniform noise on a request's temperature.
    jitter: float
    model: str
    max_tokens: int
    #: Further settings of the provider, for every request.
    llm: tuple[tuple[str, Setting], ...] = ()
    #: Where a request has the task's system prompt.
    system: SystemTurn = SystemTurn.system
    #: What one draw of the operator holds for.
    operator_for: OperatorScope = OperatorScope.generation
    #: The size of the prompt pool P_g, from 1 to the task's instructions; None for all of them.
    pool: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """One slot of a generation: what is asked for, and of whom it descends."""

    generation: int
    slot: int
    operator: Operator
    #: Ids of the parents: none for the baseline and a sample, one for a mutation, two for a crossover.
    parents: tuple[str, ...]
    #: Index of the instruction; None for all but a mutation.
    prompt: int | None
    #: What the model is asked; None for the baseline and for a given network.
    request: Request | None
    #: The source, where no model is asked for it.
    source: str = ""

    @property
    def id(self) -> str:
        """Name the candidate, e.g. `g03s07`: generation 3, slot 7."""
        return f"g{self.generation:02d}s{self.slot:02d}"


def plan_initial(task: Task, settings: Settings, *, mutations: int, temperature: float) -> tuple[Proposal, ...]:
    """Plan generation 0: the baseline in slot 0, then mutations of it (docs/paper.md, initial archive).

    It comes before Algorithm 1's loop, whose line 3 draws the pools, so it draws from the whole library. Networks that
    the task gives stand in place of the mutations.
    """
    baseline = _without_request(0, Operator.baseline, task.baseline)
    if task.given:
        sources = [given.source for given in task.given]
        return (baseline, *(_without_request(slot, Operator.given, source) for slot, source in enumerate(sources, 1)))
    library = tuple(range(len(task.instructions)))
    slots = [
        _Slot(generation=0, number=number, temperature=temperature, prompts=library)
        for number in range(1, mutations + 1)
    ]
    return (baseline, *(_mutation(task, settings, slot, [_founder(task)], PromptArchive()) for slot in slots))


def plan_generation(
    task: Task,
    settings: Settings,
    *,
    generation: int,
    elites: Sequence[Candidate],
    prompts: PromptArchive,
    temperature: float,
) -> tuple[Proposal, ...]:
    """Plan one generation (paper, Algorithm 1, lines 2 to 4).

    One operator is drawn for the whole generation, mutation with probability p_m, else crossover; `operator_for`
    can draw one for each slot instead. With a single elite, and where all parents are the baseline, a
    crossover lacks its second parent, and the generation mutates. The prompt pool P_g is drawn once; each slot draws
    from it. Without parents (`none`) every slot asks for a network at random.

    The generation is g >= 1, the temperature T_g. The elites are in the order of their niches, or what a control has in
    their place (`pool_of_parents`); the proposals are in the order of their slots.
    """
    parents = elites
    if settings.parents is ParentPolicy.baseline:
        parents = [_founder(task)]
    pool = draw_pool(len(task.instructions), settings.pool, stream(settings.seed, "pool", generation))
    numbers = range(settings.candidates)
    slots = [_Slot(generation=generation, number=number, temperature=temperature, prompts=pool) for number in numbers]
    if settings.parents is ParentPolicy.none:
        text = sample_text(task.baseline)
        return tuple(_asking(task, settings, slot, operator=Operator.sample, parents=(), text=text) for slot in slots)
    return tuple(
        _mutation(task, settings, slot, parents, prompts)
        if len(parents) < 2 or _mutates(settings, slot)
        else _crossover(task, settings, slot, parents)
        for slot in slots
    )


def pool_of_parents(policy: ParentPolicy, candidates: Mapping[str, Candidate], elites: Archive) -> Sequence[Candidate]:
    """Return the candidates that the parents of a generation are drawn from; `draw_parents` then draws.

    `trained`: all. `best_k`: the `fittest` of all, as many as there are elites. Any other: the elites, in the order of
    their niches.

    The candidates are all that trained, at least one, by id and in the order of their slots.
    """
    match policy:  # only a control looks at all candidates, which takes the longer the more there were
        case ParentPolicy.trained:
            return tuple(candidates.values())
        case ParentPolicy.best_k:
            return fittest(candidates.values(), len(elites.elites))
        case _:
            return elites_of(candidates, elites)


def elites_of(candidates: Mapping[str, Candidate], archive: Archive) -> tuple[Candidate, ...]:
    """Return the elites in the order of their niches."""
    return tuple(candidates[archive.elites[niche].name] for niche in sorted(archive.elites))


def fittest(candidates: Iterable[Candidate], count: int) -> tuple[Candidate, ...]:
    """Return the candidates of least loss, best first, at most `count`.

    Of several exactly as fit only the first one counts, as in an archive without niches (`archive.TopK`): a network
    that comes twice is one network.
    """
    first: dict[float, Candidate] = {}
    for candidate in candidates:
        first.setdefault(candidate.fitness, candidate)
    return tuple(first[fitness] for fitness in sorted(first)[:count])


def draw_parents(
    policy: ParentPolicy,
    elites: Sequence[Candidate],
    *,
    number: int,
    best: int,
    rng: np.random.Generator,
) -> tuple[Candidate, ...]:
    """Draw different elites, or members of a control's pool, as parents.

    `best`: alike among the `best` fittest (at least as many as are drawn). `curiosity`: in proportion to curiosity.
    Any other: all alike.

    Raises:
        ValueError: there are fewer elites than parents to draw.
    """
    if len(elites) < number:
        raise ValueError(f"drawing {number} parents needs as many elites; got {len(elites)}")
    pool = list(elites)
    if policy is ParentPolicy.best:
        pool = sorted(pool, key=lambda elite: (elite.fitness, elite.id))[: max(best, number)]
    drawn: list[Candidate] = []
    for _ in range(number):
        if policy is ParentPolicy.curiosity:
            index = draw_weighted([elite.curiosity for elite in pool], rng)
        else:
            index = int(rng.integers(len(pool)))
        drawn.append(pool.pop(index))
    return tuple(drawn)


def next_temperature(
    rule: TemperatureRule, temperature: float, *, best: float, best_before: float, step: float
) -> float:
    """Return the temperature of the next generation, T_{g+1}.

    `paper` is the formula as printed: up when the archive best is not worse than before, else down; an archive's
    best never gets worse, so it only ever rises. `stall` raises it only when the generation brought no better best, and
    lowers it when it did. `fixed` leaves it alone.

    The temperature is T_g, `best` and `best_before` are f*_g and f*_{g-1}, the archive's best fitness (lower is better)
    after this generation and the one before, and `step` is eta. Temperatures and eta are in [0, 1].
    """
    match rule:
        case TemperatureRule.fixed:
            rises = 0
        case TemperatureRule.paper:
            rises = 1 if best <= best_before else -1
        case TemperatureRule.stall:
            rises = 1 if best >= best_before else -1
    return clip(temperature + rises * step)


def clip(temperature: float) -> float:
    """Bring a temperature into [0, 1]; rounded to 12 decimals, so that steps of 0.05 do not gather dust."""
    return round(min(max(temperature, 0.0), 1.0), 12)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Slot:
    """Where in a search a request stands."""

    generation: int
    number: int
    #: T_g, before the request's noise.
    temperature: float
    #: Indices of the instructions that it may draw: P_g.
    prompts: tuple[int, ...]


def _without_request(slot: int, operator: Operator, source: str) -> Proposal:
    """Return a network of generation 0 that no model is asked for."""
    return Proposal(generation=0, slot=slot, operator=operator, parents=(), prompt=None, request=None, source=source)


def _founder(task: Task) -> Candidate:
    """Return the baseline as a parent, without competitors that its figures could matter to."""
    baseline = _without_request(0, Operator.baseline, task.baseline)
    return Candidate(id=baseline.id, source=baseline.source, fitness=0.0, curiosities=Fraction(1))


def _mutates(settings: Settings, slot: _Slot) -> bool:
    """Draw the operator that holds for a slot."""
    alone = settings.operator_for is OperatorScope.candidate
    where = (slot.generation, slot.number) if alone else (slot.generation,)
    return bool(stream(settings.seed, "operator", *where).random() < settings.mutation_probability)


def _mutation(
    task: Task, settings: Settings, slot: _Slot, elites: Sequence[Candidate], prompts: PromptArchive
) -> Proposal:
    (parent,) = parents = _parents_of(settings, slot, elites, 1)
    rng = stream(settings.seed, "prompt", slot.generation, slot.number)
    prompt = draw_prompt(settings.prompts, prompts, pool=slot.prompts, rng=rng)
    text = mutation_text(parent.source, task.instructions[prompt].text)
    return _asking(task, settings, slot, operator=Operator.mutation, parents=parents, text=text, prompt=prompt)


def _crossover(task: Task, settings: Settings, slot: _Slot, elites: Sequence[Candidate]) -> Proposal:
    first, second = parents = _parents_of(settings, slot, elites, 2)
    text = crossover_text(first.source, second.source, task.crossover)
    return _asking(task, settings, slot, operator=Operator.crossover, parents=parents, text=text)


def _parents_of(settings: Settings, slot: _Slot, elites: Sequence[Candidate], number: int) -> tuple[Candidate, ...]:
    rng = stream(settings.seed, "parents", slot.generation, slot.number)
    return draw_parents(settings.parents, elites, number=number, best=settings.best, rng=rng)


def _asking(
    task: Task,
    settings: Settings,
    slot: _Slot,
    *,
    operator: Operator,
    parents: Sequence[Candidate],
    text: str,
    prompt: int | None = None,
) -> Proposal:
    """Propose to ask a model, at T = clip(T_g + eps, 0, 1); the draw number belongs to the slot alone.

    So two slots that ask the same question get two answers, while two arms of an ablation that ask it in the
    same slot under the same seed share one.
    """
    where, joined = (slot.generation, slot.number), settings.system is SystemTurn.user
    noise = stream(settings.seed, "temperature", *where).uniform(-settings.jitter, settings.jitter)
    request = Request(
        model=settings.model,
        system="" if joined else task.system,
        messages=(ChatMessage(role="user", content=f"{task.system}\n\n{text}" if joined else text),),
        temperature=clip(slot.temperature + noise),
        max_tokens=settings.max_tokens,
        draw=derived_seed(settings.seed, "draw", *where) % 2**31,
        settings=settings.llm,
    )
    return Proposal(
        generation=slot.generation,
        slot=slot.number,
        operator=operator,
        parents=tuple(parent.id for parent in parents),
        prompt=prompt,
        request=request,
    )
