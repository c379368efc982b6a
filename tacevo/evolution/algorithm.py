"""The search: the paper's Algorithm 1 as a deterministic fold.

    step       lines    of a generation
    propose    1 to 4   operator, prompt pool, parents, instructions: requests; of generation 0, mutations of a baseline
    develop    4 to 6   answers of the model, the gate, trainings
    commit     7, 8     one candidate, in slot order: descriptors, niche, insertion, prompt archive
    close      9        best fitness, next temperature

Work finishes in any order and is committed in slot order, so one worker and sixteen give the same bytes. What
is expensive comes in through `Effects` and is answered from stores where it was answered before; so replaying,
resuming and extending a run are this same loop.
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import asdict, replace
from fractions import Fraction

from tacevo.choices import PAPER_AXES, Carrier
from tacevo.errors import ConfigError
from tacevo.evolution.archive import AddStatus, Elite, Individual, PersistentMap, coverage, qd_score
from tacevo.evolution.descriptors import describe
from tacevo.evolution.development import Effects, Outcome, develop
from tacevo.evolution.lines import (
    CandidateLine,
    GenerationLine,
    RepairedAnswer,
    source_hash,
    with_result,
)
from tacevo.evolution.models import Gains, gain_of
from tacevo.evolution.prompts import FAILED, curiosity
from tacevo.evolution.proposals import (
    Candidate,
    Proposal,
    elites_of,
    plan_generation,
    plan_initial,
)
from tacevo.evolution.state import LedgerWriter, Observer, Plan, SearchState
from tacevo.evolution.temperatures import clip
from tacevo.parts import Generation, Population, Trial
from tacevo.records import Operator, Rejection, Training, to_json
from tacevo.rounding import rounded
from tacevo.storage.canonical import content_hash


def run_search(plan: Plan, effects: Effects, ledger: LedgerWriter, observer: Observer) -> SearchState:
    """Run a search to generation G, or to the one that spends its budget.

    Raises:
        DivergenceError: the ledger holds a line that the search does not reproduce.
        CacheMissError: a store in replay mode lacks an answer.
    """
    state = SearchState(
        generation=0,
        temperature=plan.temperature_start,
        networks=plan.archive,
    )
    while not state.is_past(plan):
        state = step(state, plan, effects, ledger, observer)
    return state


def step(state: SearchState, plan: Plan, effects: Effects, ledger: LedgerWriter, observer: Observer) -> SearchState:
    """Run one generation: propose, develop, commit, close."""
    before = state
    lines: list[CandidateLine] = []
    outcomes = develop(
        propose(state, plan),
        effects,
        repairs=plan.repairs,
        skips=None if plan.skipping is None else plan.skipping.skips(state.candidates.values()),
    )
    for outcome in outcomes:
        check_given(outcome, plan)
        observer.developed(outcome)
        state, line = fold(state, plan, outcome)
        lines.append(line)
        ledger.commit(line)
        observer.committed(line, state)
    state, last = close(before, state, plan, lines)
    ledger.commit(last)
    observer.committed(last, state)
    return state


def check_given(outcome: Outcome, plan: Plan) -> None:
    """Refuse a baseline, or another network of the user's, that does not train."""
    proposal, result, task = outcome.proposal, outcome.result, plan.task
    if proposal.request is None and isinstance(result, Rejection):
        is_baseline = proposal.operator is Operator.baseline
        raise ConfigError(
            f"one that is rejected: {result.stage}, {result.reason}: {result.detail}",
            place=f"task.baseline of task {task.name}"
            if is_baseline
            else f"{plan.given_by}, {task.given[proposal.slot - 1].name}",
            expected="a network that trains",
        )


def propose(state: SearchState, plan: Plan) -> tuple[Proposal, ...]:
    """Propose the next generation from the state."""
    if state.generation == 0:
        return plan_initial(plan.task, plan.settings, mutations=plan.initial, temperature=state.temperature)
    return plan_generation(
        plan.task,
        plan.settings,
        population=Population(
            generation=state.generation,
            candidates=state.candidates,
            elites=elites_of(state.candidates, state.networks.archive),
        ),
        prompts=state.prompts,
        temperature=state.temperature,
        known=state.known,
    )


def fold(state: SearchState, plan: Plan, outcome: Outcome) -> tuple[SearchState, CandidateLine]:
    """Commit one outcome to the state; return the state and its ledger line."""
    after, line = commit(state, plan, outcome)
    return _with_gain(_with_rejection(_with_effect(after, plan, line), outcome), line), line


def commit(state: SearchState, plan: Plan, outcome: Outcome) -> tuple[SearchState, CandidateLine]:
    """Commit one candidate to the state (paper, Algorithm 1, lines 7 and 8); return the state and its ledger line.

    A rejected candidate is discarded: it changes no archive. Nor does a skipped one.
    """
    line = _candidate_line(outcome, plan)
    admitted, result = outcome.admitted, outcome.result
    if admitted is None:
        return state, line
    line = replace(line, **asdict(describe(admitted.profile)))
    fitness = line.fitness
    if not isinstance(result, Training) or fitness is None:
        return state, line
    telling, completion = outcome.proposal.telling, outcome.completion
    point = tuple(axis.describe(admitted.profile) for axis in plan.axes.values())
    newcomer = Individual(elite=Elite(name=line.id, objective=-fitness), point=point)
    networks, niche, status = state.networks.offer(plan.networks, newcomer)
    score = curiosity(fitness, inserted=status is not AddStatus.rejected)
    child = Candidate(
        id=line.id,
        source=admitted.source,
        fitness=fitness,
        losses=result.validation_losses,
        parameters=admitted.profile.learnt,
        flops=admitted.profile.training_flops,
        parents=line.parents,
        curiosities=Fraction(score),
        features={} if plan.skipping is None else plan.skipping.features(admitted.profile),
        note=telling.note_of(completion) if telling is not None and completion is not None else "",
    )
    candidates = _learned(state.candidates, outcome.proposal, child)
    measures = tuple(value for name, value in zip(plan.axes, point, strict=True) if name not in PAPER_AXES)
    line = replace(line, measures=measures, niche=niche, status=status, curiosity=score)
    best = min(state.best, fitness)
    state = replace(state, networks=networks, candidates=candidates, best=best)
    return _record_prompt(state, plan, line, score)


def close(
    before: SearchState, state: SearchState, plan: Plan, lines: Sequence[CandidateLine]
) -> tuple[SearchState, GenerationLine]:
    """Close a generation: its best fitness, its figures, and the next temperature (paper, Algorithm 1, line 9).

    Generation 0 leaves T_1 as it is: there is no generation before it to compare with. `trained` counts first answers
    only, as the paper has it; repaired ones are counted apart, where any answer was sent back.
    """
    fitnesses = [line.fitness for line in lines if line.fitness is not None]
    temperature = state.temperature
    if state.generation > 0:
        ended = Generation(
            number=state.generation,
            temperature=temperature,
            best=state.best,
            best_before=before.best,
            candidates=len(lines),
            trained=len(fitnesses),
            inserted=sum(line.inserted for line in lines),
        )
        temperature = clip(plan.temperature.next(ended))
    repaired = sum(line.fitness is not None for line in lines if line.repairs)
    line = GenerationLine(
        generation=state.generation,
        temperature=state.temperature,
        next_temperature=temperature,
        candidates=len(lines),
        trained=len(fitnesses) - repaired,
        best=state.best if math.isfinite(state.best) else None,
        generation_best=min(fitnesses, default=None),
        generation_median=round(statistics.median(fitnesses), 12) if fitnesses else None,
        coverage=coverage(state.networks.archive, plan.networks.niches),
        qd_score=round(qd_score(state.networks.archive), 12),
        prompt_coverage=coverage(state.prompts.archive, plan.prompts.niches),
        bounds=state.networks.bounds,
        archive=state.networks.digest,
        prompt_archive=state.prompts.digest,
        repaired=repaired if any(line.repairs for line in lines) else None,
        skipped=sum(line.skipped for line in lines if not line.repairs) or None,
    )
    return replace(state, generation=state.generation + 1, temperature=temperature), line


def _record_prompt(
    state: SearchState, plan: Plan, line: CandidateLine, score: float
) -> tuple[SearchState, CandidateLine]:
    """Let a mutation's prompt configuration compete in A_P; the mutations of generation 0 come before it begins."""
    if not plan.settings.prompts.records or line.prompt is None or line.generation == 0:
        return state, line
    trial = Trial(prompt=line.prompt, temperature=state.temperature, inserted=line.inserted, curiosity=score)
    prompts, niche, status = state.prompts.record(
        plan.prompts, trial, prompts=len(plan.task.instructions), name=line.id
    )
    return replace(state, prompts=prompts), replace(line, prompt_niche=niche, prompt_status=status)


# Not part of the paper's algorithm.
def _with_effect(state: SearchState, plan: Plan, line: CandidateLine) -> SearchState:
    """Learn what an instruction did to the loss of its child."""
    if line.prompt is None or line.skipped:
        return state
    parent = state.candidates.get(line.parents[0])
    if parent is None or not 0 < parent.fitness < math.inf or line.fitness == 0:
        return state
    change = FAILED if line.fitness is None else rounded(math.log(line.fitness / parent.fitness))
    return replace(state, prompts=state.prompts.learning(line.prompt, change))


def _with_rejection(state: SearchState, outcome: Outcome) -> SearchState:
    """Remember why a candidate was rejected; the first slot of a generation forgets the reasons of the last one."""
    kept = state.rejections if outcome.proposal.slot > 0 else ()
    new = (outcome.result,) if isinstance(outcome.result, Rejection) else ()
    return replace(state, rejections=(*kept, *new))


def _with_gain(state: SearchState, line: CandidateLine) -> SearchState:
    """Learn what came of a model's answer, in a search with several models; nothing comes of a skipped one."""
    if line.model is None or line.skipped:
        return state
    parents = line.parents or (next(iter(state.candidates)),)  # of a sample, the baseline
    gain = gain_of(line.fitness, (state.candidates[name].fitness for name in parents))
    gains = state.gains.get(line.model, Gains()).adding(gain)
    return replace(state, gains={**state.gains, line.model: gains})


def _learned(
    candidates: PersistentMap[str, Candidate], proposal: Proposal, child: Candidate
) -> PersistentMap[str, Candidate]:
    """Add a candidate, and its curiosity to that of the parent that it is a mutation of."""
    for name in proposal.parents if proposal.operator is Operator.mutation else ():
        candidates = candidates.adding(name, candidates[name].with_child(child.curiosity))
    return candidates.adding(child.id, child)


def _candidate_line(outcome: Outcome, plan: Plan) -> CandidateLine:
    """Write a candidate's line as far as its development goes.

    It says what was asked, what the model answered, and what gate and training found; descriptors and archives follow.
    """
    proposal, completion, admitted = outcome.proposal, outcome.completion, outcome.admitted
    carried = proposal.carried
    line = CandidateLine(
        generation=proposal.generation,
        slot=proposal.slot,
        id=proposal.id,
        operator=proposal.operator,
        parents=proposal.parents,
        prompt=proposal.prompt,
        request=None if proposal.request is None else content_hash(to_json(proposal.request)),
        temperature=None if carried is None else carried.temperature,
        carrier=Carrier.parameter if carried is None else plan.settings.carrier,
        level=None if carried is None else carried.level,
        effort=None if carried is None else carried.effort,
        model=proposal.request.model if proposal.request is not None and plan.settings.models else None,
        answer=None if completion is None else content_hash(completion.content()),
        dropped=() if completion is None or not plan.names_dropped else completion.dropped,
        skipped=outcome.result is None,
        repairs=tuple(
            RepairedAnswer(
                answer=content_hash(attempt.completion.content()),
                stage=attempt.rejection.stage,
                reason=attempt.rejection.reason,
                dropped=attempt.completion.dropped if plan.names_dropped else (),
            )
            for attempt in outcome.attempts
        ),
    )
    if admitted is not None:
        profile = admitted.profile
        line = replace(
            line,
            source=source_hash(admitted.source),
            parameters=profile.parameters,
            flops=profile.flops,
            learnt_outside=profile.learnt_outside,
            extra_flops=profile.extra_flops,
            not_portable=profile.not_portable,
        )
    if outcome.result is None:
        return line
    return with_result(line, outcome.result, evaluation=outcome.evaluation, rule=plan.fitness)
