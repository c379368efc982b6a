"""The proposals of a generation: operator, parents, instruction and temperature.

Pure: `plan_initial` and `plan_generation` turn the state of a search into proposals, by named random streams.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Protocol

from tacevo import parts
from tacevo.choices import Carrier, Effort, ModelChoice, OperatorScope, SystemTurn
from tacevo.evolution.archive import Archive
from tacevo.evolution.carriers import Carried, carry
from tacevo.evolution.models import Gains, draw_models
from tacevo.evolution.prompts import (
    PromptArchive,
    crossover_text,
    draw_pool,
    mutation_text,
    sample_text,
)
from tacevo.evolution.temperatures import clip
from tacevo.parts import Parents, Population, Prompts
from tacevo.randomness import derived_seed, stream
from tacevo.records import ChatMessage, Completion, Operator, Rejection, Request, Setting, Task


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """An evaluated candidate, as later generations and parts need it (`tacevo.parts.Candidate`)."""

    id: str
    source: str
    #: The fitness of the candidate; lower is better.
    fitness: float
    #: The candidate's validation losses, one an epoch.
    losses: tuple[float, ...] = ()
    #: The number of values that the candidate learns, and its forward FLOPs of one image in training mode.
    parameters: int = 0
    flops: int = 0
    #: Ids of its parents.
    parents: tuple[str, ...] = ()
    #: The exact sum of its own curiosity and those of its mutation children, and how many these are together.
    curiosities: Fraction
    scores: int = 1
    #: The features of the candidate that the surrogate sees (`tacevo.evolution.surrogate`); empty in a search without
    #: one.
    features: Mapping[str, float] = field(default_factory=dict)
    #: The note of the answer that it came of (`tacevo.evolution.told.note_of`); empty where none was asked or written.
    note: str = ""

    @property
    def curiosity(self) -> float:
        """The mean; the sum is rounded once, so that the order of its terms does not matter."""
        return float(self.curiosities) / self.scores

    def with_child(self, curiosity: float) -> "Candidate":
        """Return the candidate with the curiosity of one more mutation child."""
        return replace(self, curiosities=self.curiosities + Fraction(curiosity), scores=self.scores + 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tellable:
    """What a request may tell beside parents and instruction: what the search knows when it asks."""

    #: One or two candidates that trained.
    parents: Sequence[parts.Candidate]
    #: The baseline, once it has trained.
    baseline: parts.Candidate | None
    #: All that trained, by id, in the order in which they came.
    candidates: Mapping[str, parts.Candidate]
    #: What became of the candidates of the last generation that the gate or the training rejected, in slot order.
    rejections: Sequence[Rejection]
    #: The notes of the answers that became the parents, in the order of the parents; empty for none.
    notes: Sequence[str]


class Telling(Protocol):
    """Says what requests tell beside parents and instruction, and how they are answered (`tacevo.evolution.told`)."""

    @property
    def edits(self) -> bool:
        """Whether an answer may be edits of the first parent."""

    def message(self, text: str, known: Tellable) -> str:
        """Return the message of a mutation or a crossover with what it tells, and with the form of the answer."""

    def note_of(self, completion: Completion) -> str:
        """Return the note of an answer; empty where none is asked for, or written."""

    def without_note(self, completion: Completion) -> Completion:
        """Return an answer without its note."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The settings of the plan, from the configuration."""

    seed: int
    candidates: int
    mutation_probability: float
    parents: Parents
    prompts: Prompts
    #: Half-width of the uniform noise on a request's temperature.
    jitter: float
    model: str
    max_tokens: int
    #: Further settings of the provider, for every request.
    llm: tuple[tuple[str, Setting], ...] = ()
    #: The carrier of a request's temperature, and the efforts that it may choose from, rising.
    carrier: Carrier = Carrier.parameter
    efforts: tuple[Effort, ...] = ()
    #: The place of the task's system prompt in a request.
    system: SystemTurn = SystemTurn.system
    #: The scope of one draw of the operator.
    operator_for: OperatorScope = OperatorScope.generation
    #: The size of the prompt pool P_g, from 1 to the task's instructions; None for all of them.
    pool: int | None = None
    #: The number of slots in a row that ask the same question, each for an answer of its own; at least 1.
    answers: int = 1
    #: What a request tells beside parents and instruction, and how it is answered, from generation 1 on; None where it
    #: tells nothing, and asks for a whole class.
    telling: Telling | None = None
    #: Several models with their weights > 0, of which each slot asks one in place of `model`; empty for that one alone.
    models: tuple[tuple[str, float], ...] = ()
    choice: ModelChoice = ModelChoice.weights


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What earlier generations know, beside the networks and the prompts."""

    #: What became of the candidates of the last generation that the gate or the training rejected, in slot order.
    rejections: tuple[Rejection, ...] = ()
    #: What came of the answers of each model that was asked, by its name.
    gains: Mapping[str, Gains] = field(default_factory=dict)


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
    #: The request to the model; None for the baseline and for a given network.
    request: Request | None
    #: The source, where no model is asked for it.
    source: str = ""
    #: The temperature of the request, and what the request holds of it; None without a request.
    carried: Carried | None = None
    #: The network that the answer may be edits of, as the request has it; None where the answer is a whole class.
    edited: str | None = None
    #: What the request tells, and how it is answered; None where that is nothing.
    telling: Telling | None = None

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
    models = _models(settings, 0, range(1, mutations + 1), Known())
    slots = [
        _Slot(
            generation=0,
            number=number,
            question=number,
            temperature=temperature,
            prompts=library,
            model=models[number - 1],
        )
        for number in range(1, mutations + 1)
    ]
    return (baseline, *(_mutation(task, settings, slot, [_founder(task)], PromptArchive()) for slot in slots))


def plan_generation(
    task: Task,
    settings: Settings,
    *,
    population: Population,
    prompts: PromptArchive,
    temperature: float,
    known: Known | None = None,
) -> tuple[Proposal, ...]:
    """Plan one generation (paper, Algorithm 1, lines 2 to 4).

    One operator is drawn for the whole generation, mutation with probability p_m, else crossover; `operator_for`
    can draw one for each slot instead. With a single candidate in the pool of parents a crossover lacks its second
    one, and the generation mutates; an empty pool stands for the baseline. The prompt pool P_g is drawn once; each
    question draws from it, and is asked in so many slots in a row as `answers` says. Without parents every slot asks
    for a network at random.

    The generation is that of the population, the temperature T_g; the proposals are in the order of their slots.
    """
    generation, known = population.generation, known or Known()
    pool = draw_pool(len(task.instructions), settings.pool, stream(settings.seed, "pool", generation))
    numbers = range(settings.candidates)
    models = _models(settings, generation, numbers, known)
    slots = [
        _Slot(
            generation=generation,
            number=number,
            question=number // settings.answers,
            temperature=temperature,
            prompts=pool,
            model=model,
        )
        for number, model in zip(numbers, models, strict=True)
    ]
    if not settings.parents.has_parents:
        return tuple(_sample(task, settings, slot) for slot in slots)
    parents = settings.parents.pool(population) or [_founder(task)]
    proposals = (
        _mutation(task, settings, slot, parents, prompts)
        if len(parents) < 2 or _mutates(settings, slot)
        else _crossover(task, settings, slot, parents)
        for slot in slots
    )
    return tuple(_telling(task, settings, one, population, known) for one in proposals)


def elites_of(candidates: Mapping[str, Candidate], archive: Archive) -> tuple[Candidate, ...]:
    """Return the elites in the order of their niches."""
    return tuple(candidates[archive.elites[niche].name] for niche in sorted(archive.elites))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Slot:
    """The position of a request in a search."""

    generation: int
    number: int
    #: The number of the question, which other slots may ask, too: all but the draw follows from it.
    question: int
    #: T_g, before the request's noise.
    temperature: float
    #: Indices of the instructions that it may draw: P_g.
    prompts: tuple[int, ...]
    #: The model that is asked.
    model: str


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
    where = (slot.generation, slot.question) if alone else (slot.generation,)
    return bool(stream(settings.seed, "operator", *where).random() < settings.mutation_probability)


def _mutation(
    task: Task, settings: Settings, slot: _Slot, pool: Sequence[parts.Candidate], prompts: PromptArchive
) -> Proposal:
    (parent,) = parents = _parents_of(settings, slot, pool, 1)
    rng = stream(settings.seed, "prompt", slot.generation, slot.question)
    prompt = settings.prompts.draw(prompts.history, slot.prompts, rng)
    carried = _carried(settings, slot, task.boldness)
    text = mutation_text(parent.source, task.instructions[prompt].text, boldness=carried.words)
    return _asking(
        task, settings, slot, operator=Operator.mutation, parents=parents, text=text, prompt=prompt, carried=carried
    )


def _crossover(task: Task, settings: Settings, slot: _Slot, pool: Sequence[parts.Candidate]) -> Proposal:
    first, second = parents = _parents_of(settings, slot, pool, 2)
    carried = _carried(settings, slot, task.boldness)
    text = crossover_text(first.source, second.source, task.crossover, boldness=carried.words)
    return _asking(task, settings, slot, operator=Operator.crossover, parents=parents, text=text, carried=carried)


def _sample(task: Task, settings: Settings, slot: _Slot) -> Proposal:
    text, carried = sample_text(task.baseline), _carried(settings, slot, ())
    return _asking(task, settings, slot, operator=Operator.sample, parents=(), text=text, carried=carried)


def _parents_of(
    settings: Settings, slot: _Slot, pool: Sequence[parts.Candidate], number: int
) -> Sequence[parts.Candidate]:
    if len(pool) == number == 1:  # such as the baseline, of which generation 0 is made
        return pool
    return settings.parents.draw(pool, number, stream(settings.seed, "parents", slot.generation, slot.question))


def _asking(
    task: Task,
    settings: Settings,
    slot: _Slot,
    *,
    operator: Operator,
    parents: Sequence[parts.Candidate],
    text: str,
    carried: Carried,
    prompt: int | None = None,
) -> Proposal:
    """Propose to ask a model; the draw number belongs to the slot alone.

    So two slots that ask the same question get two answers, while two arms of an ablation that ask it in the
    same slot under the same seed share one.
    """
    joined = settings.system is SystemTurn.user
    effort: tuple[tuple[str, Setting], ...] = () if carried.effort is None else (("effort", carried.effort.value),)
    request = Request(
        model=slot.model,
        system="" if joined else task.system,
        messages=(ChatMessage(role="user", content=f"{task.system}\n\n{text}" if joined else text),),
        temperature=carried.parameter,
        max_tokens=settings.max_tokens,
        draw=derived_seed(settings.seed, "draw", slot.generation, slot.number) % 2**31,
        settings=tuple(sorted((*settings.llm, *effort))),
    )
    return Proposal(
        generation=slot.generation,
        slot=slot.number,
        operator=operator,
        parents=tuple(parent.id for parent in parents),
        prompt=prompt,
        request=request,
        carried=carried,
    )


def _carried(settings: Settings, slot: _Slot, sentences: Sequence[str]) -> Carried:
    """Draw the temperature of a request, T = clip(T_g + eps, 0, 1), and let its carrier have it."""
    rng = stream(settings.seed, "temperature", slot.generation, slot.question)
    temperature = clip(slot.temperature + rng.uniform(-settings.jitter, settings.jitter))
    return carry(temperature, by=settings.carrier, sentences=sentences, efforts=settings.efforts)


def _models(settings: Settings, generation: int, slots: Sequence[int], known: Known) -> list[str]:
    """Return the model that each slot asks."""
    if not settings.models:
        return [settings.model] * len(slots)
    return draw_models(
        settings.models, settings.choice, known.gains, seed=settings.seed, generation=generation, slots=slots
    )


def _telling(task: Task, settings: Settings, proposal: Proposal, population: Population, known: Known) -> Proposal:
    """Return a proposal whose request tells what the settings say, and asks for their form of an answer."""
    telling = settings.telling
    if proposal.request is None or telling is None:
        return proposal
    candidates = population.candidates
    parents = [candidates[name] for name in proposal.parents]
    (message,) = proposal.request.messages
    system = f"{task.system}\n\n" if settings.system is SystemTurn.user else ""
    tellable = Tellable(
        parents=parents,
        baseline=candidates.get(_founder(task).id),
        candidates=candidates,
        rejections=known.rejections,
        notes=[one.note for one in parents if isinstance(one, Candidate)],
    )
    text = telling.message(message.content.removeprefix(system), tellable)
    request = replace(proposal.request, messages=(replace(message, content=f"{system}{text}"),))
    edited = parents[0].source.strip() if telling.edits else None
    return replace(proposal, request=request, edited=edited, telling=telling)
