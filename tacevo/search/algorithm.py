"""The search: the paper's Algorithm 1 as a deterministic fold.

    run_search   for g = 0..G: plan, develop, commit in slot order, close the generation
    commit       one candidate: descriptors, niche, insertion, prompt archive
    close        one generation: best fitness, temperature

Work finishes in any order and is committed in slot order, so one worker and sixteen give the same bytes. What
is expensive comes in through `Tools` and is answered from stores where it was answered before; so replaying,
resuming and extending a run are this same loop.
"""

import hashlib
import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Protocol

from tacevo.choices import Axis, PromptPolicy, Scale, TemperatureRule
from tacevo.errors import ConfigError
from tacevo.profile import Profile
from tacevo.records import Completion, Json, Operator, Rejection, to_json
from tacevo.rules import Era, Rules
from tacevo.search.archive import (
    AddStatus,
    Elite,
    NetworkArchive,
    Placed,
    Places,
    Point,
    Tessellation,
    coverage,
    qd_score,
    quality,
)
from tacevo.search.descriptors import Descriptor, describe, scaled
from tacevo.search.development import Attempt, Outcome, Tools, develop
from tacevo.search.growing import Growing
from tacevo.search.prompts import PromptArchive, Trial, curiosity
from tacevo.search.proposals import Parent, Proposal, Settings, Task, plan_generation, plan_initial
from tacevo.search.temperature import next_temperature
from tacevo.storage.canonical import content_hash
from tacevo.storage.ledger import Ledger


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What a search is: the task, and every setting that the fold reads."""

    task: Task
    settings: Settings
    generations: int
    #: Mutations of the baseline in generation 0.
    initial: int
    networks: Tessellation | Places
    prompts: Tessellation
    #: The network archive to begin with: empty, with fixed bounds or none.
    archive: NetworkArchive
    eff_ratio_scale: Scale
    temperature_rule: TemperatureRule
    temperature_start: float
    temperature_step: float
    #: How often an answer that the gate turned away is sent back.
    repairs: int = 0
    #: The axes of the network archive.
    axes: tuple[Axis, ...] = tuple(Axis)
    #: Whether a line names the sampling settings that were not sent; the ledgers of earlier releases do not.
    names_dropped: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """An evaluated candidate, as later generations need it."""

    id: str
    source: str
    fitness: float
    #: The exact sum of its own curiosity and those of its mutation children, and how many these are together.
    curiosity: Fraction
    curiosities: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchState:
    """Everything the next step depends on."""

    #: The next generation to run.
    generation: int
    temperature: float
    networks: NetworkArchive
    prompts: PromptArchive = field(default_factory=PromptArchive)
    #: Every evaluated candidate, by id.
    candidates: Growing[Candidate] = field(default_factory=Growing)
    #: f*_{g-1}: the archive's best fitness after the last closed generation.
    best: float = math.inf


class Observer(Protocol):
    """Who watches a search; nothing it does may change one."""

    def developed(self, outcome: Outcome) -> None:
        """Take an outcome before it is committed."""

    def committed(self, line: dict[str, Json], state: SearchState) -> None:
        """Take a line of the ledger after it was committed, and the state that results."""


def run_search(
    plan: Plan, tools: Tools, ledger: Ledger, observer: Observer, *, since: SearchState | None = None
) -> SearchState:
    """Run a search from its beginning, or from a later state, to generation G, through the stores and onto the ledger.

    Raises:
        DivergenceError: the ledger holds a line that the search does not reproduce.
        CacheMissError: a store in replay mode lacks an answer.
    """
    state = since or SearchState(generation=0, temperature=plan.temperature_start, networks=plan.archive)
    while state.generation <= plan.generations:
        state = step(state, plan, tools, ledger, observer)
    return state


def run_eras(
    plan: Plan,
    eras: Sequence[Era],
    tools: Callable[[Rules], Tools],
    ledger: Ledger,
    observer: Observer,
) -> SearchState:
    """Run a search whose generations follow several rules, one after the other; each change has a ledger line.

    Args:
        plan: of the whole search.
        eras: from generation 0 on; one, unless the run was continued under other rules.
        tools: gives the effects under the rules of an era.
        ledger: for every line.
        observer: who watches.

    Raises:
        TacevoError: as `run_search`.
    """
    state = None
    ends = [era.generation - 1 for era in eras[1:]] + [plan.generations]
    for era, end in zip(eras, ends, strict=True):
        if state is not None:
            ledger.commit(era.line())
        part = replace(plan, generations=end, names_dropped=era.rules.core >= 2)
        state = run_search(part, tools(era.rules), ledger, observer, since=state)
    if state is None:
        raise ValueError("a search has one era at least; got none")
    return state


def step(state: SearchState, plan: Plan, tools: Tools, ledger: Ledger, observer: Observer) -> SearchState:
    """Run one generation: plan, complete, admit, evaluate, commit."""
    proposals = propose(state, plan)
    lines: list[dict[str, Json]] = []
    before = state
    for outcome in develop(proposals, tools, repairs=plan.repairs):
        _insist_on_baseline(outcome, plan.task)
        observer.developed(outcome)
        state, entry = commit(state, plan, outcome, tools.evaluation_key)
        lines.append(ledger.commit(entry))
        observer.committed(lines[-1], state)
    state, entry = close(before, state, plan, lines)
    observer.committed(ledger.commit(entry), state)
    return state


def propose(state: SearchState, plan: Plan) -> tuple[Proposal, ...]:
    """Plan the next generation from the state."""
    if state.generation == 0:
        return plan_initial(plan.task, plan.settings, mutations=plan.initial, temperature=state.temperature)
    elites = state.networks.archive.elites
    return plan_generation(
        plan.task,
        plan.settings,
        generation=state.generation,
        elites=[_parent(state.candidates[elites[niche].name]) for niche in sorted(elites)],
        prompts=state.prompts,
        temperature=state.temperature,
    )


def commit(
    state: SearchState, plan: Plan, outcome: Outcome, evaluation_key: Callable[[str], str]
) -> tuple[SearchState, dict[str, Json]]:
    """Fold one outcome into the state (paper, Algorithm 1, lines 7 and 8); return the state and its ledger entry.

    A candidate that was turned away is discarded: it changes no archive.
    """
    entry = _entry(outcome, plan)
    if outcome.admitted is None:
        return state, entry
    descriptor = describe(outcome.admitted.profile)
    entry |= {"evaluation": evaluation_key(outcome.admitted.source)} | _measured(outcome.admitted.profile, descriptor)
    if isinstance(outcome.result, Rejection):
        return state, entry
    fitness = outcome.result.fitness
    placed = Placed(
        elite=Elite(name=outcome.proposal.id, objective=-fitness),
        point=_point(descriptor, plan),
    )
    networks, niche, status = state.networks.offer(plan.networks, placed)
    score = curiosity(fitness, inserted=status is not AddStatus.rejected)
    state = replace(state, networks=networks, candidates=_with_child(state.candidates, outcome, score))
    entry |= {
        "fitness": fitness,
        "train_losses": list(outcome.result.train_losses),
        "validation_losses": list(outcome.result.validation_losses),
        "predictions": outcome.result.predictions_sha256,
        "weights": outcome.result.weights_sha256,
        "niche": niche,
        "status": status.value,
        "curiosity": score,
    }
    if outcome.result.not_deterministic:
        entry["not_deterministic"] = list(outcome.result.not_deterministic)
    state, prompt_entry = _record_prompt(state, plan, outcome.proposal, status, score)
    return state, entry | prompt_entry


def close(
    before: SearchState, state: SearchState, plan: Plan, lines: Sequence[Mapping[str, Json]]
) -> tuple[SearchState, dict[str, Json]]:
    """End a generation: its best fitness, its figures, and the next temperature (paper, Algorithm 1, line 9).

    Generation 0 leaves T_1 as it is: there is no generation before it to compare with. `trained` counts first answers
    only, as the paper has it; those that were corrected are counted apart, where any was sent back.
    """
    elites = state.networks.archive.elites
    best = min((-elite.objective for elite in elites.values()), default=math.inf)
    temperature = state.temperature
    if state.generation > 0:
        temperature = next_temperature(
            plan.temperature_rule, temperature, best=best, best_before=before.best, step=plan.temperature_step
        )
    bounds = state.networks.bounds
    fitnesses = [line["fitness"] for line in lines if "fitness" in line]
    repaired = [line for line in lines if "fitness" in line and "repairs" in line]
    entry: dict[str, Json] = {
        "kind": "generation",
        "generation": state.generation,
        "temperature": state.temperature,
        "next_temperature": temperature,
        "candidates": len(lines),
        "trained": len(fitnesses) - len(repaired),
        "best": best if math.isfinite(best) else None,
        "generation_best": min(fitnesses, default=None),
        "generation_median": round(statistics.median(fitnesses), 12) if fitnesses else None,
        "coverage": coverage(state.networks.archive, plan.networks.niches),
        "qd_score": round(qd_score(state.networks.archive, quality), 12),
        "prompt_coverage": coverage(state.prompts.archive, plan.prompts.niches),
        "bounds": None if bounds is None else to_json(bounds),
        "archive": content_hash({str(niche): to_json(elites[niche]) for niche in elites}),
        "prompt_archive": content_hash({str(niche): to_json(trial) for niche, trial in state.prompts.trials.items()}),
    }
    if any("repairs" in line for line in lines):
        entry["repaired"] = len(repaired)
    return replace(state, generation=state.generation + 1, temperature=temperature, best=best), entry


def _insist_on_baseline(outcome: Outcome, task: Task) -> None:
    """Refuse to search from a baseline that does not train."""
    if outcome.proposal.operator is Operator.baseline and isinstance(outcome.result, Rejection):
        result = outcome.result
        raise ConfigError(
            f"the baseline of task {task.name} (task.baseline) does not train: {result.stage}, {result.reason}: "
            f"{result.detail}"
        )


def _entry(outcome: Outcome, plan: Plan) -> dict[str, Json]:
    """Begin a candidate's ledger entry with what was asked and what came of it."""
    proposal = outcome.proposal
    entry: dict[str, Json] = {
        "kind": "candidate",
        "generation": proposal.generation,
        "slot": proposal.slot,
        "id": proposal.id,
        "operator": proposal.operator.value,
        "parents": list(proposal.parents),
        "prompt": proposal.prompt,
        "request": None if proposal.request is None else content_hash(to_json(proposal.request)),
        "temperature": None if proposal.request is None else proposal.request.temperature,
        **_answered(outcome.completion, plan),
    }
    if outcome.attempts:
        entry["repairs"] = [_attempted(attempt, plan) for attempt in outcome.attempts]
    if outcome.admitted is not None:
        entry["source"] = hashlib.sha256(outcome.admitted.source.encode()).hexdigest()
    if isinstance(outcome.result, Rejection):
        entry |= {"stage": outcome.result.stage.value, "reason": outcome.result.reason.value}
    return entry


def _answered(completion: Completion | None, plan: Plan) -> dict[str, Json]:
    """Name an answer by its hash, with the settings that its request was sent without, where there are such."""
    if completion is None:
        return {"answer": None}
    dropped = {"dropped": list(completion.dropped)} if completion.dropped and plan.names_dropped else {}
    return {"answer": content_hash(completion.content()), **dropped}


def _attempted(attempt: Attempt, plan: Plan) -> dict[str, Json]:
    """Write down an answer that was sent back."""
    return {
        **_answered(attempt.completion, plan),
        "stage": attempt.rejection.stage.value,
        "reason": attempt.rejection.reason.value,
    }


def _measured(profile: Profile, descriptor: Descriptor) -> dict[str, Json]:
    """Write down what the probe measured; which kernels are not portable, only where there are such."""
    entry: dict[str, Json] = {"parameters": profile.parameters, "flops": profile.flops, **to_json(descriptor)}
    return entry | ({"not_portable": list(profile.not_portable)} if profile.not_portable else {})


def _record_prompt(
    state: SearchState, plan: Plan, proposal: Proposal, status: AddStatus, score: float
) -> tuple[SearchState, dict[str, Json]]:
    """Let a mutation's prompt configuration compete in A_P; the mutations of generation 0 come before it begins."""
    without = plan.settings.prompts is PromptPolicy.none
    if without or proposal.prompt is None or proposal.generation == 0:
        return state, {}
    trial = Trial(
        prompt=proposal.prompt,
        temperature=state.temperature,
        inserted=status is not AddStatus.rejected,
        curiosity=score,
    )
    prompts, niche, prompt_status = state.prompts.record(
        plan.prompts, trial, prompts=len(plan.task.instructions), name=proposal.id
    )
    return replace(state, prompts=prompts), {"prompt_niche": niche, "prompt_status": prompt_status.value}


def _point(descriptor: Descriptor, plan: Plan) -> Point:
    """Give a candidate's coordinates on the axes of the network archive, before normalisation."""
    values = {Axis.arch_div: descriptor.arch_div, Axis.eff_ratio: scaled(descriptor.eff_ratio, plan.eff_ratio_scale)}
    return tuple(values[axis] for axis in plan.axes)


def _with_child(candidates: Growing[Candidate], outcome: Outcome, score: float) -> Growing[Candidate]:
    """Add a candidate, and tell its parents how curious it was."""
    proposal = outcome.proposal
    if outcome.admitted is None or isinstance(outcome.result, Rejection):
        raise ValueError(f"{proposal.id} was turned away and cannot be a parent")
    exact = Fraction(score)
    for name in proposal.parents if proposal.operator is Operator.mutation else ():
        parent = candidates[name]
        taught = replace(parent, curiosity=parent.curiosity + exact, curiosities=parent.curiosities + 1)
        candidates = candidates.adding(name, taught)
    child = Candidate(
        id=proposal.id,
        source=outcome.admitted.source,
        fitness=outcome.result.fitness,
        curiosity=exact,
        curiosities=1,
    )
    return candidates.adding(child.id, child)


def _parent(candidate: Candidate) -> Parent:
    mean = float(candidate.curiosity) / candidate.curiosities  # the sum is rounded once, whatever the order
    return Parent(id=candidate.id, source=candidate.source, fitness=candidate.fitness, curiosity=mean)
