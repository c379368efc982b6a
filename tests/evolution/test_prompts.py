"""Promise: prompt configurations compete by r in A_P, and prompts are drawn as their policy says."""

import math
from collections import Counter
from dataclasses import replace

import fakes
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from probabilities import agrees

from tacevo.evolution.archive import AddStatus, Tessellation
from tacevo.evolution.instructions import Curious, Effect, Uniform, Unrecorded, effect_weights
from tacevo.evolution.lines import CandidateLine
from tacevo.evolution.prompts import PromptArchive, curiosity, draw_weighted
from tacevo.parts import Prompts, Trial
from tacevo.randomness import stream

#: Two niches, of low and of high prompt indices.
TWO = Tessellation([(0.0, 0.5), (1.0, 0.5)])
DRAWS = 3000


def trial(prompt: int, *, inserted: bool, score: float = 0.5, temperature: float = 0.5) -> Trial:
    """Make a trial."""
    return Trial(prompt=prompt, temperature=temperature, inserted=inserted, curiosity=score)


def recorded(*trials: Trial) -> PromptArchive:
    """Record trials of ten prompts in order."""
    archive = PromptArchive()
    for number, tried in enumerate(trials):
        archive, *_ = archive.record(TWO, tried, prompts=10, name=f"t{number}")
    return archive


@pytest.mark.parametrize(
    ("fitness", "inserted", "expected"),
    [(0.0, True, 2.0), (1.0, True, 1.5), (3.0, True, 1.25), (0.0, False, 0.5), (5.0, False, 0.5)],
)
def test_curiosity_is_above_one_where_the_child_was_inserted(fitness: float, inserted: bool, expected: float) -> None:
    """1 + 1 / (1 + f), else 0.5 whatever the fitness."""
    assert curiosity(fitness, inserted=inserted) == expected


@pytest.mark.parametrize(
    ("prompt", "prompts", "temperature", "niche"), [(0, 10, 0, 0), (9, 10, 0, 1), (0, 1, 0, 0), (0, 10, 1, 2)]
)
def test_niche_is_that_of_prompt_and_temperature(prompt: int, prompts: int, temperature: float, niche: int) -> None:
    """The first prompt lies at 0 and the last at 1, the only one of a library at 0; the other axis is T_g."""
    corners = Tessellation([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
    tried = trial(prompt, inserted=True, temperature=temperature)
    assert PromptArchive().record(corners, tried, prompts=prompts, name="x")[1] == niche


@given(st.lists(st.tuples(st.integers(0, 9), st.booleans(), st.floats(0.5, 2)), max_size=30))
def test_niche_holds_its_first_productive_trial(tried: list[tuple[int, bool, float]]) -> None:
    """Whatever others taught; or its first trial, where none was productive. No archive changes."""
    archive = PromptArchive()
    held: dict[int, tuple[Trial, str]] = {}
    for number, (prompt, inserted, score) in enumerate(tried):
        one, name, niche = trial(prompt, inserted=inserted, score=score), f"t{number}", int(prompt > 4)
        takes = niche not in held or (inserted and not held[niche][0].inserted)
        expected = AddStatus.rejected if not takes else AddStatus.improved if niche in held else AddStatus.new
        before, trials = archive, dict(archive.trials)
        archive, *told = archive.record(TWO, one, prompts=10, name=name)
        assert told == [niche, expected]
        assert before.trials == trials
        if takes:
            held[niche] = one, name
    assert {niche: (one, archive.archive.elites[niche].name) for niche, one in archive.trials.items()} == held


def test_last_choice_is_drawn_where_rounding_leaves_the_target_behind_all() -> None:
    """Ten times 0.1 add up to less than 1, one after the other."""

    class Largest(np.random.Generator):
        def random(self) -> float:  # type: ignore[override]
            return float(np.nextafter(1.0, 0.0))

    assert draw_weighted([0.1] * 10, Largest(np.random.PCG64(0))) == 9


@pytest.mark.parametrize("policy", [Uniform(), Unrecorded()])
def test_uniform_draws_do_not_look_at_the_archive(policy: Prompts) -> None:
    """`uniform` and `none` draw from the whole library alike, with the same numbers."""
    archive = recorded(trial(1, inserted=True, score=2.0))
    drawn = [policy.draw(archive.history, range(4), stream(0, "x", i)) for i in range(DRAWS)]
    assert drawn == [int(stream(0, "x", i).integers(4)) for i in range(DRAWS)]


@pytest.mark.parametrize(
    ("archive", "pool", "shares"),
    [
        (PromptArchive(), 4, dict.fromkeys(range(4), 1 / 4)),  # nothing is known yet
        # Three times the curiosity comes three times as often; the eight untried weigh 0.5 each.
        (recorded(trial(2, inserted=False), trial(8, inserted=True, score=1.5)), 10, {8: 1.5 / 6, 2: 0.5 / 6}),
    ],
)
def test_curiosity_draws_in_proportion(archive: PromptArchive, pool: int, shares: dict[int, float]) -> None:
    """Every instruction stays within reach."""
    rng = stream(0, "proportion")
    drawn = Counter(Curious().draw(archive.history, range(pool), rng) for _ in range(DRAWS))
    assert set(drawn) == set(range(pool))
    assert all(agrees(drawn[prompt], share, DRAWS) for prompt, share in shares.items())


def test_effect_weighs_by_what_an_instruction_did() -> None:
    """By hand: the mean change of all is 0; shrunken by five children, exp(-4 effect), within 0.1 and 10."""
    changes = {0: (5, -1.0), 1: (15, 1.0), 2: (200, 300.0), 3: (300, -300.0)}
    weights = effect_weights(changes, range(5))
    assert weights == pytest.approx([math.exp(0.4), math.exp(-0.2), 0.1, 10.0, 1.0], rel=1e-8)
    shifted = {prompt: (count, total + 7 * count) for prompt, (count, total) in changes.items()}
    assert effect_weights(shifted, [0, 4]) == pytest.approx([weights[0], 1.0], rel=1e-6)


def test_effect_draws_in_proportion_and_begins_uniformly() -> None:
    """Only from the pool."""
    learnt = PromptArchive().learning(1, -0.5).learning(3, 0.5).learning(1, -0.5)
    weights = dict(zip((1, 2, 3), effect_weights(learnt.changes, (1, 2, 3)), strict=True))
    rng = stream(0, "proportion")
    drawn = Counter(Effect().draw(learnt.history, (1, 2, 3), rng) for _ in range(DRAWS))
    assert set(drawn) == {1, 2, 3}
    assert all(agrees(drawn[prompt], weight / sum(weights.values()), DRAWS) for prompt, weight in weights.items())
    first = [Effect().draw(PromptArchive().history, range(4), stream(0, "x", i)) for i in range(50)]
    assert first == [int(stream(0, "x", i).integers(4)) for i in range(50)]


def test_effect_moves_the_mix_to_what_works() -> None:
    """By the effects and the noise that the published ablation measured: 17 instructions, 80 requests, 200 searches."""
    effects = [-0.23, -0.22, 0.54, 0.19, *[0.0] * 13]
    rng, late = np.random.default_rng(0), Counter[int]()
    for search in range(200):
        archive = PromptArchive()
        for request in range(80):
            draws = stream(search, "effect", request)
            prompt = Effect().draw(archive.history, range(17), draws)
            late[prompt] += request >= 40
            archive = archive.learning(prompt, effects[prompt] + 0.35 * rng.normal())
    share = {prompt: late[prompt] / late.total() for prompt in range(17)}
    assert min(share[0], share[1]) > 1.4 / 17
    assert share[2] < 0.5 / 17


def test_a_search_learns_effects_from_its_children() -> None:
    """From every mutation, by its line and its parent's; one that did not train counts as e times worse."""
    plan = fakes.plan(generations=6)
    plan = replace(plan, settings=replace(plan.settings, prompts=Effect()))
    _, recorder = fakes.search(plan)
    fitness = {line.id: line.fitness for line in recorder.lines if isinstance(line, CandidateLine) and line.fitness}
    changes: dict[int, list[float]] = {}
    for line in recorder.lines:
        if isinstance(line, CandidateLine) and line.prompt is not None:
            child = fitness.get(line.id)
            change = 1.0 if child is None else math.log(child / fitness[line.parents[0]])
            changes.setdefault(line.prompt, []).append(change)
    _, uniform = fakes.search(fakes.plan(generations=6))
    learnt = recorder.states[-1].prompts.changes
    assert {prompt: count for prompt, (count, _) in learnt.items()} == {one: len(of) for one, of in changes.items()}
    assert all(total == pytest.approx(sum(changes[prompt])) for prompt, (_, total) in learnt.items())
    assert any(1.0 in of for of in changes.values())
    asked = [[(one.id, one.prompt) for one in of.lines if isinstance(one, CandidateLine)] for of in (recorder, uniform)]
    assert asked[0] != asked[1]
    assert [one for one in asked[0] if one[0] < "g01"] == [one for one in asked[1] if one[0] < "g01"]
