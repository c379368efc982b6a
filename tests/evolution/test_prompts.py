"""Promise: prompt configurations compete by r in A_P, and prompts are drawn as their policy says."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from probabilities import agrees

from tacevo.choices import PromptPolicy
from tacevo.evolution.archive import AddStatus, Tessellation
from tacevo.evolution.prompts import PromptArchive, Trial, curiosity, draw_prompt, draw_weighted
from tacevo.randomness import stream

#: Two niches, of low and of high prompt indices.
TWO = Tessellation([(0.0, 0.5), (1.0, 0.5)])
DRAWS = 3000


def trial(prompt: int, *, inserted: bool, score: float = 0.5, temperature: float = 0.5) -> Trial:
    """Make a trial."""
    return Trial(prompt=prompt, temperature=temperature, inserted=inserted, curiosity=score)


def recorded(*trials: Trial) -> tuple[PromptArchive, list[AddStatus]]:
    """Record trials of ten prompts in order."""
    archive = PromptArchive()
    statuses = []
    for number, tried in enumerate(trials):
        archive, _, status = archive.record(TWO, tried, prompts=10, name=f"t{number}")
        statuses.append(status)
    return archive, statuses


@pytest.mark.parametrize(("fitness", "expected"), [(0.0, 2.0), (1.0, 1.5), (3.0, 1.25)])
def test_inserted_child_scores_above_one(fitness: float, expected: float) -> None:
    """Curiosity is 1 + 1 / (1 + f) where the child was inserted."""
    assert curiosity(fitness, inserted=True) == expected


@pytest.mark.parametrize("fitness", [None, 0.0, 5.0])
def test_child_that_was_not_inserted_scores_a_half(fitness: float | None) -> None:
    """Curiosity is 0.5 where r = 0, whatever the fitness."""
    assert curiosity(fitness, inserted=False) == 0.5


def test_inserted_child_needs_a_fitness() -> None:
    """A child cannot have been inserted without a fitness."""
    with pytest.raises(ValueError, match="needs a fitness; got None"):
        curiosity(None, inserted=True)


def test_first_trial_takes_an_empty_niche_even_unproductive() -> None:
    """Where nobody was, r = 0 is enough."""
    archive, statuses = recorded(trial(1, inserted=False))
    assert statuses == [AddStatus.new]
    assert archive.trials == {0: trial(1, inserted=False)}


def test_unproductive_trial_never_replaces() -> None:
    """With r = 0 a trial beats neither r = 0 nor r = 1, and leaves no trace."""
    archive, statuses = recorded(trial(1, inserted=False), trial(2, inserted=False))
    assert statuses[1] is AddStatus.rejected
    assert archive.trials[0].prompt == 1
    archive, statuses = recorded(trial(1, inserted=True), trial(2, inserted=False))
    assert statuses[1] is AddStatus.rejected
    assert archive.trials[0].prompt == 1


def test_productive_trial_replaces_an_unproductive_one() -> None:
    """With r = 1 a trial beats r = 0."""
    archive, statuses = recorded(trial(1, inserted=False), trial(2, inserted=True, score=1.5))
    assert statuses == [AddStatus.new, AddStatus.improved]
    assert archive.trials[0] == trial(2, inserted=True, score=1.5)
    assert archive.archive.elites[0].name == "t1"


def test_tie_keeps_the_incumbent() -> None:
    """Of two productive trials the first keeps the niche, even where the second taught more."""
    archive, statuses = recorded(trial(1, inserted=True, score=1.1), trial(2, inserted=True, score=1.9))
    assert statuses[1] is AddStatus.rejected
    assert archive.trials[0].prompt == 1


def test_record_leaves_the_old_archive_unchanged() -> None:
    """Recording gives a new archive."""
    before, _ = recorded(trial(1, inserted=False))
    before.record(TWO, trial(2, inserted=True), prompts=10, name="later")
    assert before.trials == {0: trial(1, inserted=False)}


def test_prompts_spread_over_the_whole_axis() -> None:
    """The first prompt lies at 0 and the last at 1; the only prompt of a library lies at 0."""
    assert PromptArchive().record(TWO, trial(0, inserted=True), prompts=10, name="x")[1] == 0
    assert PromptArchive().record(TWO, trial(9, inserted=True), prompts=10, name="x")[1] == 1
    assert PromptArchive().record(TWO, trial(0, inserted=True), prompts=1, name="x")[1] == 0


def test_temperature_is_the_second_axis() -> None:
    """Trials of one prompt at different temperatures do not compete."""
    cold_and_hot = Tessellation([(0.5, 0.0), (0.5, 1.0)])
    for temperature, niche in [(0.1, 0), (0.9, 1)]:
        tried = trial(5, inserted=True, temperature=temperature)
        assert PromptArchive().record(cold_and_hot, tried, prompts=10, name="x")[1] == niche


def test_last_choice_is_drawn_where_rounding_leaves_the_target_behind_all() -> None:
    """Ten times 0.1 add up to less than 1, one after the other."""

    class Largest(np.random.Generator):
        def random(self) -> float:  # type: ignore[override]
            return float(np.nextafter(1.0, 0.0))

    assert draw_weighted([0.1] * 10, Largest(np.random.PCG64(0))) == 9


@given(st.lists(st.tuples(st.integers(0, 9), st.booleans()), max_size=30))
def test_niche_is_productive_as_soon_as_one_of_its_trials_was(tried: list[tuple[int, bool]]) -> None:
    """Every niche holds its first productive trial, or its first trial where none was productive."""
    archive, _ = recorded(*(trial(prompt, inserted=inserted) for prompt, inserted in tried))
    for niche, prompts in enumerate([range(5), range(5, 10)]):
        here = [(prompt, inserted) for prompt, inserted in tried if prompt in prompts]
        first = next((entry for entry in here if entry[1]), here[0] if here else None)
        held = archive.trials.get(niche)
        assert (held and (held.prompt, held.inserted)) == first


@pytest.mark.parametrize("policy", [PromptPolicy.uniform, PromptPolicy.none])
def test_uniform_draws_do_not_look_at_the_archive(policy: PromptPolicy) -> None:
    """`uniform` and `none` draw from the whole library alike, with the same numbers."""
    full, _ = recorded(trial(1, inserted=True, score=2.0))
    for archive in (full, PromptArchive()):
        drawn = [draw_prompt(policy, archive, pool=range(4), rng=stream(0, "x", i)) for i in range(DRAWS)]
        assert drawn == [int(stream(0, "x", i).integers(4)) for i in range(DRAWS)]


def test_curiosity_draws_uniformly_while_the_archive_is_empty() -> None:
    """Before anything is known, every instruction is as likely."""
    rng = stream(0, "empty")
    drawn = Counter(draw_prompt(PromptPolicy.curiosity, PromptArchive(), pool=range(4), rng=rng) for _ in range(DRAWS))
    assert all(agrees(drawn[prompt], 1 / 4, DRAWS) for prompt in range(4))


def test_curiosity_draws_in_proportion() -> None:
    """A prompt with three times the curiosity comes three times as often; the eight untried weigh 0.5 each."""
    archive, _ = recorded(trial(2, inserted=False, score=0.5), trial(8, inserted=True, score=1.5))
    rng = stream(0, "proportion")
    drawn = Counter(draw_prompt(PromptPolicy.curiosity, archive, pool=range(10), rng=rng) for _ in range(DRAWS))
    assert set(drawn) == set(range(10))
    assert agrees(drawn[8], 1.5 / 6, DRAWS)
    assert agrees(drawn[2], 0.5 / 6, DRAWS)


@given(st.lists(st.floats(0.5, 2), min_size=1, max_size=20), st.integers(0, 2**30))
def test_weighted_draw_is_an_index(weights: list[float], seed: int) -> None:
    """A draw names one of the weights, whatever rounding does to their sum."""
    assert 0 <= draw_weighted(weights, stream(seed)) < len(weights)
