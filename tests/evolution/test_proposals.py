"""Promise: a generation's requests follow from the seed, the elites and the archives, as Algorithm 1 says.

The texts of whole requests stand in __snapshots__ and change only on purpose: every recorded answer is stored
under them.
"""

import itertools
from collections import Counter
from dataclasses import replace
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from probabilities import agrees
from syrupy.assertion import SnapshotAssertion

from tacevo.evolution import instructions, parents
from tacevo.evolution.archive import Tessellation
from tacevo.evolution.prompts import PromptArchive, crossover_text, mutation_text, system_prompt
from tacevo.evolution.proposals import Candidate, Proposal, Settings, plan_generation, plan_initial
from tacevo.parts import Population, Prompts, Trial
from tacevo.parts.kinds import PROMPTS
from tacevo.parts.registry import of_settings
from tacevo.records import Contract, Instruction, Kind, Loss, Operator, Request, Task

GENERATIONS = 2000

CONTRACT = Contract(
    class_name="ImageRegressionCNN",
    kind=Kind.regression,
    loss=Loss.mse,
    in_channels=3,
    image_size=64,
    outputs=3,
    output_argument="num_outputs",
)
TEMPLATE = (
    "Write $class_name for $in_channels x $image_size x $image_size images; $output_argument is $outputs: $names.\n"
)
TASK = Task(
    name="force",
    contract=CONTRACT,
    baseline="class ImageRegressionCNN:\n    '''a0'''\n",
    system=system_prompt(TEMPLATE, CONTRACT, ["Fx", "Fy", "Fz"]),
    instructions=tuple(Instruction(id=f"i{number}", text=f"Do number {number}.") for number in range(5)),
    crossover="Combine both.",
)
SETTINGS = Settings(
    seed=3,
    candidates=4,
    mutation_probability=0.85,
    parents=parents.Uniform(),
    prompts=instructions.Uniform(),
    jitter=0.1,
    model="grammar-1",
    max_tokens=4096,
    llm=(("slip_rate", 0.05),),
)
ALWAYS = replace(SETTINGS, mutation_probability=1.0)
NEVER = replace(SETTINGS, mutation_probability=0.0)
RANDOM = replace(ALWAYS, parents=parents.Nobody())
ELITES = [
    Candidate(
        id=f"g00s{number:02d}",
        source=f"class A:\n    n = {number}\n",
        fitness=fitness,
        curiosities=Fraction(curiosity),
    )
    for number, (fitness, curiosity) in enumerate([(0.3, 0.5), (0.1, 0.5), (0.2, 1.5), (0.4, 1.5)])
]


SOURCES = {elite.id: elite.source for elite in ELITES}


def planned(
    settings: Settings = SETTINGS,
    *,
    generation: int = 1,
    elites: list[Candidate] = ELITES,
    prompts: PromptArchive | None = None,
    temperature: float = 0.6,
) -> tuple[Proposal, ...]:
    """Plan one generation."""
    return plan_generation(
        TASK,
        settings,
        population=Population(generation=generation, candidates={one.id: one for one in elites}, elites=elites),
        prompts=prompts or PromptArchive(),
        temperature=temperature,
    )


def requests_of(proposals: tuple[Proposal, ...]) -> list[Request]:
    """Return the requests, which all but the baseline have."""
    return [proposal.request for proposal in proposals if proposal.request is not None]


def text_of(request: Request) -> str:
    """Write a whole request out, as the golden files have it."""
    (message,) = request.messages
    figures = f"{request.model}, temperature {request.temperature}, {request.max_tokens} tokens, draw {request.draw}"
    return f"{figures}, {dict(request.settings)}\n\nsystem:\n{request.system}\n{message.role}:\n{message.content}"


def productive_archive() -> PromptArchive:
    """Make a prompt archive that knows one productive prompt, number 4."""
    trial = Trial(prompt=4, temperature=0.6, inserted=True, curiosity=1.5)
    return PromptArchive().record(Tessellation([(0.5, 0.5)]), trial, prompts=5, name="x")[0]


@pytest.mark.parametrize("settings", [ALWAYS, NEVER, RANDOM], ids=["mutation", "crossover", "sample"])
def test_request_is_golden(settings: Settings, recorded_text: SnapshotAssertion) -> None:
    """Every character and figure of a request is as recorded."""
    assert text_of(requests_of(planned(settings))[0]) == recorded_text


def test_generation_zero_is_the_baseline_and_its_mutations() -> None:
    """Slot 0 holds a0 itself and asks nothing; every other slot mutates it."""
    baseline, *mutations = plan_initial(TASK, SETTINGS, mutations=3, temperature=0.6)
    assert (baseline.id, baseline.operator, baseline.parents) == ("g00s00", Operator.baseline, ())
    assert (baseline.source, baseline.request, baseline.prompt) == (TASK.baseline, None, None)
    assert [proposal.id for proposal in mutations] == ["g00s01", "g00s02", "g00s03"]
    assert {(proposal.operator, proposal.parents) for proposal in mutations} == {(Operator.mutation, ("g00s00",))}
    assert all(TASK.baseline.strip() in text_of(request) for request in requests_of(tuple(mutations)))


@pytest.mark.parametrize("other", [{"prompts": instructions.Curious(), "parents": parents.Curious()}, {"pool": 1}])
def test_generation_zero_draws_uniformly_from_the_whole_library(other: dict[str, Any]) -> None:
    """Nothing is known yet, and pools belong to the generations of Algorithm 1's loop."""
    plans = [plan_initial(TASK, one, mutations=9, temperature=0.6) for one in (SETTINGS, replace(SETTINGS, **other))]
    assert plans[0] == plans[1]


def test_unknown_placeholder_is_refused() -> None:
    """The message lists the placeholders there are; a doubled dollar is one."""
    assert system_prompt("$$5", CONTRACT, []) == "$5"
    with pytest.raises(ValueError, match=r"names \$sise; it may name \$class_name, .*\$names$"):
        system_prompt("$sise", CONTRACT, [])


def test_operator_is_mutation_with_probability_p_m() -> None:
    """Over many generations the part of mutations is p_m, within an exact binomial bound."""
    single = replace(SETTINGS, candidates=1)
    drawn = Counter(planned(single, generation=number)[0].operator for number in range(1, GENERATIONS + 1))
    assert agrees(drawn[Operator.mutation], 0.85, GENERATIONS)
    assert drawn[Operator.mutation] + drawn[Operator.crossover] == GENERATIONS


def test_mutation_asks_with_parent_and_instruction_it_names() -> None:
    """With p_m = 1 every slot; what the proposal says of itself is what the request holds."""
    mutated = [one for number in range(1, 100) for one in planned(ALWAYS, generation=number)]
    for one, request in zip(mutated, requests_of(tuple(mutated)), strict=True):
        assert one.operator is Operator.mutation
        assert one.prompt is not None
        (source,) = (SOURCES[name] for name in one.parents)
        assert request.messages[0].content == mutation_text(source, TASK.instructions[one.prompt].text)


def test_crossover_has_two_different_parents_in_both_orders() -> None:
    """With p_m = 0 every slot, if there is somebody to cross with; the instruction is not of the library."""
    crossed = [one for number in range(1, 100) for one in planned(NEVER, generation=number)]
    assert {(one.operator, one.prompt) for one in crossed} == {(Operator.crossover, None)}
    assert {one.parents for one in crossed} == set(itertools.permutations(SOURCES, 2))
    for one, request in zip(crossed, requests_of(tuple(crossed)), strict=True):
        first, second = (SOURCES[name] for name in one.parents)
        assert request.messages[0].content == crossover_text(first, second, "Combine both.")
    assert {one.operator for one in planned(NEVER, elites=ELITES[:1])} == {Operator.mutation}


def test_sample_asks_for_no_parent_and_for_another_network_in_every_slot() -> None:
    """All slots ask the same question, which shows the baseline; their draw numbers differ."""
    proposals = planned(RANDOM)
    assert {(one.operator, one.parents, one.prompt) for one in proposals} == {(Operator.sample, (), None)}
    requests = requests_of(proposals)
    (text,) = {request.messages[0].content for request in requests}
    assert TASK.baseline.strip() in text
    assert len({request.draw for request in requests}) == len(requests)


@given(st.floats(0, 1), st.floats(0, 1), st.integers(0, 2**31))
def test_jitter_is_narrow_and_clipped(temperature: float, jitter: float, seed: int) -> None:
    """Each request's temperature is within the jitter of T_g and within [0, 1]."""
    settings = replace(ALWAYS, jitter=jitter, seed=seed)
    for request in requests_of(planned(settings, temperature=temperature)):
        assert request.temperature is not None
        assert abs(request.temperature - temperature) <= jitter + 1e-12
        assert 0 <= request.temperature <= 1


def test_draw_number_belongs_to_seed_generation_and_slot() -> None:
    """No two slots share a draw, so that equal questions get different answers; each has noise of its own."""
    assert len({request.temperature for request in requests_of(planned())}) == 4
    seeds = [replace(SETTINGS, seed=seed) for seed in (0, 1)]
    plans = [planned(settings, generation=generation) for settings in seeds for generation in (1, 2, 3)]
    draws = [request.draw for proposals in plans for request in requests_of(proposals)]
    assert len(set(draws)) == len(draws) == 24
    assert all(0 <= draw < 2**31 for draw in draws)


def shared(proposals: tuple[Proposal, ...]) -> list[tuple[object, ...]]:
    """Return what all arms of an ablation have in common."""
    return [(one.parents, one.request.temperature, one.request.draw) for one in proposals if one.request is not None]


@given(st.integers(0, 2**31), st.integers(1, 50), st.sampled_from([0.0, 0.5, 1.0]))
def test_arms_share_their_random_numbers(seed: int, generation: int, p_m: float) -> None:
    """Whatever A_P holds: `none` only stops its recording, a pool of all is none, and a larger B adds slots."""
    plain = replace(SETTINGS, seed=seed, mutation_probability=p_m)
    expected = planned(plain, generation=generation)

    def arm(**changes: Any) -> tuple[Proposal, ...]:
        return planned(replace(plain, **changes), generation=generation, prompts=productive_archive())

    assert (
        arm(prompts=instructions.Unrecorded()) == arm(pool=len(TASK.instructions)) == arm(candidates=9)[:4] == expected
    )
    assert shared(arm(prompts=instructions.Curious())) == shared(arm(pool=1)) == shared(expected)


@pytest.mark.parametrize("policy", [of_settings(PROMPTS, name, None) for name in PROMPTS.ours])
def test_generation_draws_its_instructions_from_one_pool(policy: Prompts) -> None:
    """All slots of a generation, whatever their number and the policy, draw from `pool` different instructions."""
    many = replace(ALWAYS, candidates=60, prompts=policy, pool=2)
    plans = [planned(many, generation=generation, prompts=productive_archive()) for generation in range(1, 21)]
    pools = [{one.prompt for one in plan} for plan in plans]
    assert {len(pool) for pool in pools} == {2}
    assert set().union(*pools) == set(range(5))


@pytest.mark.slow
def test_curious_draw_prefers_what_is_productive_in_its_pool() -> None:
    """A pool without a productive instruction is drawn from alike; one with it yields that one more often."""
    many = replace(ALWAYS, candidates=GENERATIONS, prompts=instructions.Curious(), pool=2)
    shares = []
    for generation in range(1, 9):
        proposals = planned(many, generation=generation, prompts=productive_archive())
        counts = Counter(proposal.prompt for proposal in proposals)
        shares.append(0.75 if 4 in counts else 0.5)
        assert agrees(max(counts.values()) if 4 not in counts else counts[4], shares[-1], GENERATIONS)
    assert set(shares) == {0.5, 0.75}
