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


@pytest.mark.parametrize("policy", [PromptPolicy.uniform, PromptPolicy.none])
def test_uniform_draws_do_not_look_at_the_archive(policy: PromptPolicy) -> None:
    """`uniform` and `none` draw from the whole library alike, with the same numbers."""
    archive = recorded(trial(1, inserted=True, score=2.0))
    drawn = [draw_prompt(policy, archive, pool=range(4), rng=stream(0, "x", i)) for i in range(DRAWS)]
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
    drawn = Counter(draw_prompt(PromptPolicy.curiosity, archive, pool=range(pool), rng=rng) for _ in range(DRAWS))
    assert set(drawn) == set(range(pool))
    assert all(agrees(drawn[prompt], share, DRAWS) for prompt, share in shares.items())
