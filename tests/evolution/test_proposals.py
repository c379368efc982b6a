"""Promise: a generation's requests follow from the seed, the elites and the archives, as Algorithm 1 says.

The texts of whole requests stand in tests/golden/ and change only on purpose: every recorded answer is stored
under them.
"""

import itertools
from collections import Counter
from dataclasses import replace
from fractions import Fraction

import pytest
from checkout import GOLDEN
from hypothesis import given
from hypothesis import strategies as st
from probabilities import agrees

from tacevo.choices import ParentPolicy, PromptPolicy
from tacevo.evolution.archive import Tessellation
from tacevo.evolution.prompts import PromptArchive, Trial, crossover_text, mutation_text, system_prompt
from tacevo.evolution.proposals import Candidate, Proposal, Settings, plan_generation, plan_initial
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
    parents=ParentPolicy.uniform,
    best=2,
    population=3,
    tournament=2,
    prompts=PromptPolicy.uniform,
    jitter=0.1,
    model="grammar-1",
    max_tokens=4096,
    llm=(("slip_rate", 0.05),),
)
ALWAYS = replace(SETTINGS, mutation_probability=1.0)
NEVER = replace(SETTINGS, mutation_probability=0.0)
RANDOM = replace(ALWAYS, parents=ParentPolicy.none)
ELITES = [
    Candidate(
        id=f"g00s{number:02d}",
        source=f"class A:\n    n = {number}\n",
        fitness=fitness,
        curiosities=Fraction(curiosity),
    )
    for number, (fitness, curiosity) in enumerate([(0.3, 0.5), (0.1, 0.5), (0.2, 1.5), (0.4, 1.5)])
]


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
        generation=generation,
        elites=elites,
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


@pytest.mark.parametrize(("name", "settings"), [("mutation", ALWAYS), ("crossover", NEVER), ("sample", RANDOM)])
def test_request_is_golden(name: str, settings: Settings) -> None:
    """Every character and figure of a request is as recorded."""
    golden = (GOLDEN / f"request_{name}.txt").read_text(encoding="utf-8")
    assert text_of(requests_of(planned(settings))[0]) == golden


def test_mutation_message_holds_parent_and_instruction() -> None:
    """The parent's source is fenced and loses only blank ends."""
    text = mutation_text("\nclass A:\n    pass\n\n", "Widen it.")
    assert text == "Parent network:\n\n```python\nclass A:\n    pass\n```\n\nInstruction: Widen it.\n"


def test_crossover_message_holds_both_parents_in_order() -> None:
    """The first parent stands first."""
    text = crossover_text("class A: ...", "class B: ...", "Combine.")
    assert text.index("class A") < text.index("Second parent") < text.index("class B") < text.index("Combine.")


def test_system_prompt_is_filled_in() -> None:
    """Every placeholder has a value from the contract, and a doubled dollar is one."""
    assert TASK.system == "Write ImageRegressionCNN for 3 x 64 x 64 images; num_outputs is 3: Fx, Fy, Fz.\n"
    assert system_prompt("$$5", CONTRACT, []) == "$5"


def test_unknown_placeholder_is_refused() -> None:
    """The message lists the placeholders there are."""
    with pytest.raises(ValueError, match=r"names \$sise; it may name \$class_name, .*\$names$"):
        system_prompt("$sise", CONTRACT, [])


def test_generation_zero_is_the_baseline_and_its_mutations() -> None:
    """Slot 0 holds a0 itself and asks nothing; every other slot mutates it."""
    baseline, *mutations = plan_initial(TASK, SETTINGS, mutations=3, temperature=0.6)
    assert (baseline.id, baseline.operator, baseline.parents) == ("g00s00", Operator.baseline, ())
    assert (baseline.source, baseline.request, baseline.prompt) == (TASK.baseline, None, None)
    assert [proposal.id for proposal in mutations] == ["g00s01", "g00s02", "g00s03"]
    assert {(proposal.operator, proposal.parents) for proposal in mutations} == {(Operator.mutation, ("g00s00",))}
    assert all(TASK.baseline.strip() in text_of(request) for request in requests_of(tuple(mutations)))


def test_generation_zero_draws_uniformly_under_every_policy() -> None:
    """Nothing is known yet, so curiosity starts like the others."""
    curious = replace(SETTINGS, prompts=PromptPolicy.curiosity, parents=ParentPolicy.curiosity)
    plans = [plan_initial(TASK, settings, mutations=5, temperature=0.6) for settings in (SETTINGS, curious)]
    assert plans[0] == plans[1]


def test_one_operator_a_generation() -> None:
    """All slots of a generation have the same operator."""
    for generation in range(1, 40):
        assert len({proposal.operator for proposal in planned(generation=generation)}) == 1


def test_operator_is_mutation_with_probability_p_m() -> None:
    """Over many generations the part of mutations is p_m, within an exact binomial bound."""
    single = replace(SETTINGS, candidates=1)
    drawn = Counter(planned(single, generation=number)[0].operator for number in range(1, GENERATIONS + 1))
    assert agrees(drawn[Operator.mutation], 0.85, GENERATIONS)
    assert drawn[Operator.mutation] + drawn[Operator.crossover] == GENERATIONS


@pytest.mark.parametrize(("settings", "operator"), [(ALWAYS, Operator.mutation), (NEVER, Operator.crossover)])
def test_certain_probabilities_are_certain(settings: Settings, operator: Operator) -> None:
    """With p_m = 1 every generation mutates, with p_m = 0 none does."""
    drawn = {planned(settings, generation=generation)[0].operator for generation in range(1, 100)}
    assert drawn == {operator}


def test_single_elite_mutates() -> None:
    """With nobody to cross with, the generation mutates even where crossover was drawn."""
    assert {proposal.operator for proposal in planned(NEVER, elites=ELITES[:1])} == {Operator.mutation}


def test_mutation_asks_with_parent_and_instruction_it_names() -> None:
    """What the proposal says of itself is what the request holds."""
    for proposal in planned(ALWAYS):
        assert proposal.prompt is not None
        assert proposal.request is not None
        (parent,) = (elite for elite in ELITES if (elite.id,) == proposal.parents)
        text = TASK.instructions[proposal.prompt].text
        assert proposal.request.messages[0].content == mutation_text(parent.source, text)


def test_crossover_has_two_different_parents() -> None:
    """Nobody is crossed with itself; the instruction is the fixed one and is not a prompt of the library."""
    for generation in range(1, 100):
        for proposal in planned(NEVER, generation=generation, elites=ELITES[:2]):
            assert sorted(proposal.parents) == ["g00s00", "g00s01"]
            assert proposal.prompt is None
            assert proposal.request is not None
            assert proposal.request.messages[0].content.endswith("Instruction: Combine both.\n")


def test_parents_come_in_both_orders() -> None:
    """Which parent stands first is drawn, too."""
    pairs = {proposal.parents for number in range(1, 50) for proposal in planned(NEVER, generation=number)}
    ids = [elite.id for elite in ELITES]
    assert pairs == set(itertools.permutations(ids, 2))


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
        assert abs(request.temperature - temperature) <= jitter + 1e-12
        assert 0 <= request.temperature <= 1


def test_jitter_differs_from_slot_to_slot() -> None:
    """Every slot has noise of its own; without jitter all have T_g itself."""
    assert len({request.temperature for request in requests_of(planned())}) == 4
    still = replace(SETTINGS, jitter=0.0)
    assert {request.temperature for request in requests_of(planned(still))} == {0.6}


def test_draw_number_belongs_to_seed_generation_and_slot() -> None:
    """No two slots share a draw, so that equal questions get different answers."""
    seeds = [replace(SETTINGS, seed=seed) for seed in (0, 1)]
    plans = [planned(settings, generation=generation) for settings in seeds for generation in (1, 2, 3)]
    draws = [request.draw for proposals in plans for request in requests_of(proposals)]
    assert len(set(draws)) == len(draws) == 24
    assert all(0 <= draw < 2**31 for draw in draws)


def test_plan_is_a_function_of_its_arguments() -> None:
    """Planning again gives the same proposals, whatever was planned between."""
    first = planned(generation=5)
    planned(generation=4)
    assert planned(generation=5) == first


@given(st.integers(0, 2**31), st.integers(1, 50), st.sampled_from([0.0, 0.5, 1.0]))
def test_without_prompt_archive_the_requests_are_the_same(seed: int, generation: int, p_m: float) -> None:
    """`prompts=none` only stops the recording: its requests equal those of `uniform`, whatever A_P holds."""
    uniform = replace(SETTINGS, seed=seed, mutation_probability=p_m)
    none = replace(uniform, prompts=PromptPolicy.none)
    recorded = planned(uniform, generation=generation, prompts=productive_archive())
    assert planned(none, generation=generation) == recorded


@given(st.integers(0, 2**31), st.integers(1, 50))
def test_dropped_draw_leaves_the_others_alone(seed: int, generation: int) -> None:
    """Under another prompt policy, parents, temperatures and draws stay: the arms share their random numbers."""
    uniform = replace(ALWAYS, seed=seed)
    curious = replace(uniform, prompts=PromptPolicy.curiosity)
    pairs = zip(
        planned(uniform, generation=generation),
        planned(curious, generation=generation, prompts=productive_archive()),
        strict=True,
    )
    for one, other in pairs:
        assert one.request is not None
        assert other.request is not None
        assert (one.parents, one.request.temperature, one.request.draw) == (
            other.parents,
            other.request.temperature,
            other.request.draw,
        )


def drawn(settings: Settings, generation: int = 1, prompts: PromptArchive | None = None) -> set[int | None]:
    """Return the instructions that one generation asks for."""
    return {proposal.prompt for proposal in planned(settings, generation=generation, prompts=prompts)}


@pytest.mark.parametrize("policy", PromptPolicy)
def test_generation_draws_its_instructions_from_one_pool(policy: PromptPolicy) -> None:
    """All slots of a generation, whatever their number and the policy, draw from `pool` different instructions."""
    many = replace(ALWAYS, candidates=60, prompts=policy, pool=2)
    pools = [drawn(many, generation, productive_archive()) for generation in range(1, 21)]
    assert {len(pool) for pool in pools} == {2}
    assert set().union(*pools) == set(range(5))


@pytest.mark.slow
def test_curious_draw_prefers_what_is_productive_in_its_pool() -> None:
    """A pool without a productive instruction is drawn from alike; one with it yields that one more often."""
    many = replace(ALWAYS, candidates=GENERATIONS, prompts=PromptPolicy.curiosity, pool=2)
    shares = []
    for generation in range(1, 9):
        proposals = planned(many, generation=generation, prompts=productive_archive())
        counts = Counter(proposal.prompt for proposal in proposals)
        shares.append(0.75 if 4 in counts else 0.5)
        assert agrees(max(counts.values()) if 4 not in counts else counts[4], shares[-1], GENERATIONS)
    assert set(shares) == {0.5, 0.75}


def test_pool_of_the_whole_library_changes_no_draw() -> None:
    """The default, and a pool as large as the library, give the plans that there were before pools."""
    assert planned(replace(ALWAYS, pool=len(TASK.instructions))) == planned(ALWAYS)


def test_pool_leaves_generation_0_and_all_other_draws_alone() -> None:
    """Pools belong to the generations of Algorithm 1's loop; parents, temperatures and draw numbers stay."""
    small = replace(ALWAYS, pool=1)
    begun = [plan_initial(TASK, settings, mutations=9, temperature=0.6) for settings in (ALWAYS, small)]
    assert begun[0] == begun[1]
    assert [proposal.parents for proposal in planned(small)] == [proposal.parents for proposal in planned(ALWAYS)]
    pairs = zip(requests_of(planned(small)), requests_of(planned(ALWAYS)), strict=True)
    assert all((one.temperature, one.draw) == (other.temperature, other.draw) for one, other in pairs)


def test_fewer_slots_are_the_first_of_more() -> None:
    """A larger B adds slots and changes none."""
    assert planned(replace(SETTINGS, candidates=9))[:4] == planned(SETTINGS)
