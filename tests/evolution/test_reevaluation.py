"""Promise: elites that are trained again compete by the median of all their losses, within a generation's budget."""

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from statistics import median

import fakes
import pytest
from hand_runs import altered, closed
from hand_runs import run as hand_run

from analysis.runs.archive_history import archive_history
from tacevo.choices import FitnessRule
from tacevo.evolution.archive import Elite, Individual, NetworkArchive, TopK
from tacevo.evolution.lines import CandidateLine, GenerationLine, ReevaluationLine, SearchLine
from tacevo.evolution.reevaluation import fitness_by_id
from tacevo.evolution.state import Plan, SearchState
from tacevo.profile import Admitted
from tacevo.records import Completion, Given, Operator, Reason, Rejection, Request, Stage, Training
from tacevo.rounding import rounded

#: Two slots of each generation train an elite again.
PLAN = replace(fakes.plan(generations=8), reevaluations=2)


class Copies(fakes.FakeLLM):
    """Answers with the baseline."""

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer every request alike."""
        for place, completion in super().complete(requests):
            yield place, replace(completion, text=fakes.TASK.baseline)


def again(recorder: fakes.Recorder) -> list[ReevaluationLine]:
    """Return the lines of further trainings."""
    return [line for line in recorder.lines if isinstance(line, ReevaluationLine)]


def losses_by_source(lines: list[SearchLine]) -> dict[str, dict[int, float]]:
    """Collect the losses of each source by the numbers of their seeds, from the lines alone."""
    losses: dict[str, dict[int, float]] = {}
    for line in lines:
        if not isinstance(line, GenerationLine) and line.source is not None:
            of_source = losses.setdefault(line.source, {})
            for one in line.by_seed():
                loss = math.inf if one.validation_losses is None else one.validation_losses[-1]
                of_source[one.seed] = loss
    return losses


@pytest.mark.parametrize("seeds", [1, 3])
def test_every_elite_competes_by_the_median_of_its_losses(seeds: int) -> None:
    """At the end of every generation: in each niche none of all candidates has a lower median."""
    plan = replace(PLAN, seeds=seeds)
    _, recorder = fakes.search(plan)
    seen: list[SearchLine] = []
    for line, state in zip(recorder.lines, recorder.states, strict=True):
        seen.append(line)
        if isinstance(line, GenerationLine):
            _check_archive(plan, seen, state)
    assert any(not line.kept for line in again(recorder))


def _check_archive(plan: Plan, lines: list[SearchLine], state: SearchState) -> None:
    """Fill the niches again by brute force, and compare."""
    known = {
        source: math.inf if math.inf in of.values() else rounded(median(of.values()))
        for source, of in losses_by_source(lines).items()
    }
    best: dict[int, float] = {}
    bounds = state.networks.bounds
    assert bounds is not None
    for line in lines:
        if isinstance(line, CandidateLine) and line.fitness is not None and line.source is not None:
            niche = plan.networks.niche_of(bounds.normalise(state.networks.history[line.id].point))  # type: ignore[union-attr]
            best[niche] = min(best.get(niche, math.inf), known[line.source])
    held = {niche: -elite.objective for niche, elite in state.networks.archive.elites.items()}
    assert held == {niche: fitness for niche, fitness in best.items() if fitness < math.inf}
    assert state.best == min(held.values())


def test_budget_is_that_of_a_search_without() -> None:
    """Every generation has as many slots as before, of which the last train elites again and ask nothing."""
    _, recorder = fakes.search(PLAN)
    for generation in range(1, 9):
        slots = [line for line in recorder.lines if line.kind != "generation" and line.generation == generation]
        assert [line.slot for line in slots] == list(range(6))
        assert [line.kind for line in slots] == ["candidate"] * 4 + ["reevaluation"] * 2
    ended = [line for line in recorder.lines if isinstance(line, GenerationLine)]
    assert [(line.candidates, line.reevaluated) for line in ended] == [(4, None)] + [(4, 2)] * 8
    assert all(line.generation > 0 for line in again(recorder))


def test_elites_with_the_fewest_trainings_come_first_each_time_with_new_seeds() -> None:
    """No elite is trained again while another one has fewer trainings; no seed comes twice for a source."""
    _, recorder = fakes.search(PLAN)
    counts: Counter[str] = Counter()
    held: dict[str, str] = {}
    for line, state in zip(recorder.lines, recorder.states, strict=True):
        if isinstance(line, GenerationLine):
            names = {elite.name for elite in state.networks.archive.elites.values()}
            held = {name: state.candidates[name].source for name in names}
            begun, taken = counts.copy(), set[str]()
        elif isinstance(line, ReevaluationLine):
            assert line.id in held
            assert line.seed == counts[str(line.source)]
            counts[str(line.source)] += 1
            taken.add(line.id)
            rest = [begun[_source_of(recorder, name)] for name in held.keys() - taken]
            assert begun[str(line.source)] <= min(rest, default=math.inf)
        elif isinstance(line, CandidateLine) and line.fitness is not None:
            counts[str(line.source)] = max(counts[str(line.source)], 1)
    seeds = [(line.source, line.seed) for line in again(recorder)]
    assert len(set(seeds)) == len(seeds)


def _source_of(recorder: fakes.Recorder, name: str) -> str:
    return next(str(line.source) for line in recorder.lines if isinstance(line, CandidateLine) and line.id == name)


def test_copy_of_a_network_that_was_trained_again_cannot_win_by_the_old_draw() -> None:
    """Its seeds are those of the first one, so it has the same losses and the same median."""
    lucky, unlucky = 0.1, 0.9

    def luck(source: str, seed: int) -> Training | Rejection:
        result = fakes.evaluate(fakes.TASK.baseline)
        assert isinstance(result, Training)
        return replace(result, validation_losses=(1.0, unlucky if seed else lucky))

    _, recorder = fakes.search(replace(PLAN, generations=2), evaluate=luck, llm=Copies())
    last = recorder.states[-1]
    assert [line.seed for line in again(recorder)] == [1, 2]
    assert {elite.name: -elite.objective for elite in last.networks.archive.elites.values()} == {"g00s00": unlucky}
    assert {one.fitness for one in last.candidates.values()} == {unlucky}


def test_elite_that_fails_when_trained_again_leaves_the_archive_for_good() -> None:
    """Its line says why; no later candidate of its source comes back, and the search goes on from the others."""

    def failing(source: str, seed: int) -> Training | Rejection:
        if seed and source == fakes.TASK.baseline:
            return Rejection(stage=Stage.train, reason=Reason.not_finite, detail="loss is nan")
        return fakes.noisy(source, 0)

    _, recorder = fakes.search(PLAN, evaluate=failing)
    (failed,) = (line for line in again(recorder) if line.stage is Stage.train)
    assert (failed.id, failed.reason) == ("g00s00", Reason.not_finite)
    assert (failed.estimate, failed.kept, failed.fitness) == (None, False, None)
    names = {elite.name for elite in recorder.states[-1].networks.archive.elites.values()}
    assert names
    assert "g00s00" not in names


def test_elite_that_the_gate_rejects_later_keeps_its_estimate() -> None:
    """A stricter probe says nothing about its losses: it stays in the archive by those that it has."""
    refusal = Rejection(stage=Stage.probe, reason=Reason.bad_output, detail="stricter")
    _, recorder = fakes.search(replace(PLAN, generations=1), measure=lambda source: refusal)
    first, *_ = again(recorder)
    before = next(line for line in recorder.lines if isinstance(line, CandidateLine) and line.id == first.id)
    assert (first.stage, first.evaluation, first.kept) == (Stage.probe, None, True)
    assert first.estimate == before.fitness == fitness_by_id(recorder.lines, FitnessRule.last)[first.id]


def test_policy_is_asked_once_about_a_source() -> None:
    """A replay would parse what a model wrote, perhaps for another version of Python; only the baseline is checked."""
    seen = list[str]()

    def inspect(source: str) -> Admitted | Rejection:
        seen.append(source)
        return fakes.inspect(source)

    given = (Given(name="mine", source="class Net: mine = 1\n"),)
    _, recorder = fakes.search(replace(PLAN, task=replace(fakes.TASK, given=given), generations=2), inspect=inspect)
    assert again(recorder)
    assert any(line.operator is Operator.given for line in recorder.lines if isinstance(line, CandidateLine))
    assert seen == [fakes.TASK.baseline]


def test_search_whose_elites_all_fail_again_goes_on_from_the_baseline() -> None:
    """An empty archive has no best, nothing to train again, and mutations of the baseline."""

    def once(source: str, seed: int) -> Training | Rejection:
        if seed:
            return Rejection(stage=Stage.train, reason=Reason.not_finite, detail="loss is nan")
        return fakes.evaluate(source)

    _, recorder = fakes.search(replace(PLAN, generations=2), evaluate=once, llm=Copies())
    first, second = (line for line in recorder.lines if isinstance(line, GenerationLine) and line.generation)
    assert (first.reevaluated, first.best, first.coverage) == (1, None, 0)
    assert (second.reevaluated, second.best, second.candidates) == (None, None, 6)
    asked = [line for line in recorder.lines if isinstance(line, CandidateLine) and line.generation == 2]
    assert {line.parents for line in asked} == {("g00s00",)}


def test_archive_can_lose_its_best_and_the_temperature_hears_of_it() -> None:
    """The printed rule lowers T where the best is worse than before, which no other archive can bring about."""
    _, recorder = fakes.search(replace(PLAN, generations=20))
    ended = [line for line in recorder.lines if isinstance(line, GenerationLine)]
    steps = [
        (now.best > before.best, now.next_temperature < now.temperature)
        for before, now in itertools.pairwise(ended)
        if now.best is not None and before.best is not None and 0 < now.temperature < 1
    ]
    assert any(worse for worse, _ in steps)
    assert all(worse == lowered for worse, lowered in steps)


def test_slots_that_ask_share_the_draws_of_a_search_without() -> None:
    """Generation 0 is the same, and in generation 1 the first slots ask the same, if the elites are the same."""
    plans = (PLAN, replace(PLAN, reevaluations=0))
    lines = [[line for line in fakes.search(plan)[1].lines if isinstance(line, CandidateLine)] for plan in plans]
    asked = [[(one.id, one.request) for one in of if one.generation < 2 and one.slot < 4] for of in lines]
    assert asked[0] == asked[1]


def test_what_a_search_knew_follows_from_its_lines() -> None:
    """Fitness by id, as the state has it at the end; of a search without further trainings, as recorded."""
    for plan in (PLAN, replace(PLAN, reevaluations=0)):
        _, recorder = fakes.search(plan)
        last = recorder.states[-1]
        known = {name: one.fitness for name, one in last.candidates.items()}
        assert fitness_by_id(recorder.lines, FitnessRule.last) == {
            name: loss for name, loss in known.items() if loss < math.inf
        }
        assert (math.inf in known.values()) == (plan is PLAN)


def test_archive_of_every_generation_is_rebuilt_from_the_lines() -> None:
    """For tables and figures, which do not replay a search."""
    _, recorder = fakes.search(PLAN)
    candidates = [line for line in recorder.lines if isinstance(line, CandidateLine)]
    ends = [state for line, state in zip(recorder.lines, recorder.states, strict=True) if line.kind == "generation"]
    changed = altered(
        hand_run(candidates, [closed(number) for number in range(9)], archive={"kind": "extract"}),
        reevaluations=tuple(again(recorder)),
    )
    archives = archive_history(changed, fakes.NETWORKS.centroids)
    assert [dict(archive.elites) for archive in archives] == [dict(state.networks.archive.elites) for state in ends]


def test_archive_without_niches_trains_nothing_again() -> None:
    """Its best of all would have to be drawn from all again; there is no such kind."""
    archive = NetworkArchive()
    archive, *_ = archive.offer(TopK(niches=2), Individual(elite=Elite(name="a", objective=-1.0), point=(0.0, 0.0)))
    with pytest.raises(ValueError, match="niches"):
        archive.reestimated(TopK(niches=2), ["a"], -2.0)
