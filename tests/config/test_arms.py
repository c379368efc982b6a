"""Promise: an arm of an ablation changes what it is about, with every other choice, and is never a copy of another.

What the arms have in common is shown on searches with fake effects: their draws are those of `none` wherever their
settings leave a choice to be drawn.
"""

import functools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import fakes
import pytest
from checkout import ROOT
from refusals import refused

from tacevo.choices import Scale
from tacevo.config.arms import check_change, parse_arm, read_arm, split_arm
from tacevo.config.compose import compose
from tacevo.config.conf_folder import groups
from tacevo.config.identity import identity
from tacevo.config.schema import RunConfig
from tacevo.config.task_texts import facts_without_data
from tacevo.errors import ConfigError
from tacevo.evolution.algorithm import run_search
from tacevo.evolution.archive import AddStatus
from tacevo.evolution.descriptors import scaled
from tacevo.evolution.lines import CandidateLine, GenerationLine
from tacevo.evolution.proposals import Proposal, plan_initial
from tacevo.evolution.state import Plan
from tacevo.records import Mode, written
from tacevo.runs.decisions import Decisions, Parts
from tacevo.runs.wiring import build_plan, build_settings
from tacevo.storage.ledger import Ledger

ARMS = [arm for arm in groups()["ablation"] if arm != "none"]

#: Arms that ask with another temperature from the first request on.
OTHER_START = ("fixed_temperature_0", "fixed_temperature_1")

#: A search that a model answers, so that every arm is another one.
ASKED = "llm=anthropic"

#: Fields of a ledger line that say what was asked; an arm that shares them with `none` asks the same model the same.
REQUEST = ("id", "operator", "parents", "prompt", "request", "temperature")


@functools.cache
def arm(name: str, *overrides: str) -> RunConfig:
    """Compose an arm, once for all tests; only the grammar draws the networks of `random_sampling`."""
    asked = "llm=grammar" if name == "random_sampling" else ASKED
    return compose([asked, f"ablation={name}", *overrides])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make one directory for the centroids of all searches."""
    return tmp_path_factory.mktemp("centroids")


def planned(config: RunConfig, folder: Path) -> Plan:
    """Plan a search of fakes with an arm's settings: few niches, and some crossovers unless it has none."""
    archive = replace(config.archive, niches=12, prompt_niches=8, samples=200, kept=5)
    search = replace(config.search, generations=6, candidates=6, initial=3)
    store = replace(config.store, root=str(folder))
    small = replace(config, archive=archive, search=search, store=store)
    parts = Parts.of(small, Decisions(None))
    plan = build_plan(small, fakes.TASK, facts_without_data(small), Mode.record, parts=parts)
    p_m = 1.0 if config.proposals.mutation_probability == 1 else 0.6
    sizes = replace(plan.settings, mutation_probability=p_m)
    return replace(plan, settings=replace(sizes, model="m", llm=()))  # random_sampling is composed for another model


@functools.cache
def searched(name: str, folder: Path) -> tuple[list[dict[str, Any]], fakes.Recorder]:
    """Search with an arm's settings; return the candidates' lines and all that an observer saw."""
    recorder = fakes.Recorder()
    run_search(planned(arm(name), folder), fakes.effects(), Ledger(), recorder)
    return [written(line) for line in recorder.lines if isinstance(line, CandidateLine)], recorder


def common(one: list[dict[str, Any]], other: list[dict[str, Any]], generation: int) -> bool:
    """Say whether two searches asked the same in a generation, and were answered and trained the same."""
    fields = (*REQUEST, "answer", "source", "evaluation", "fitness")
    first, second = (
        [tuple(str(line.get(field)) for field in fields) for line in lines if line["generation"] == generation]
        for lines in (one, other)
    )
    return first == second


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("arm_name", "clash"),
    [
        ("no_prompt_archive", "prompts=curiosity"),
        ("fixed_temperature", "temperature.rule=stall"),
        ("llm_vs_grammar", "llm.top_p=0.9"),
    ],
)
def test_arm_wins_over_the_command_line(arm_name: str, clash: str) -> None:
    """What an arm is about holds in it, also where the choices for all arms contradict it."""
    assert arm(arm_name, clash) == arm(arm_name)


def test_what_an_arm_is_not_about_stays_the_users() -> None:
    """Beside an arm's own settings, those of the command line hold."""
    config = arm("fixed_temperature", "temperature=stall", "temperature.start=0.3", "seed=7")
    settings = (config.temperature.rule, config.temperature.start, config.seed, config.llm.provider)
    assert settings == ("fixed", 0.3, 7, "anthropic")
    assert arm("drift", "archive.axes=[arch_div]").archive.axes == ("arch_div",)


@pytest.mark.parametrize(
    ("overrides", "setting"),
    [
        (["ablation=no_prompt_archive", "prompts=none"], "prompts.policy=none"),
        (["ablation=mutation_only", "proposals.mutation_probability=1"], "proposals.mutation_probability=1.0"),
        (["ablation=llm_vs_grammar", "llm.slip_rate=0.5"], "llm.provider=grammar"),
    ],
)
def test_arm_that_changes_nothing_is_refused(overrides: list[str], setting: str) -> None:
    """A copy of `none` under another name would pass for a finding; the message names the arm and the setting."""
    name = overrides[0]
    with refused(ConfigError, place=name, got=setting, remedy="leave this arm out"):
        compose(overrides)


@pytest.mark.parametrize("name", ARMS)
def test_every_arm_is_refused_on_top_of_itself(name: str) -> None:
    """Each arm names first what it is about: laid over a search that has it, it is seen to change nothing."""
    settings = read_arm(name)
    with refused(ConfigError, place=f"ablation={name}", expected="a copy of ablation=none"):
        check_change(name, settings, settings)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("mine", "", "a mapping of at least one setting"),
        ("mine", "{}", "a mapping of at least one setting"),
        ("mine", "- prompts", "a mapping"),
        ("mine", "a: [", "YAML"),
        ("mine", "defaults:\n  - override /prompts: none\n", "settings"),
        ("none", "prompts: {policy: none}", "the empty mapping"),
    ],
)
def test_file_that_is_not_an_arm_is_rejected(name: str, text: str, expected: str) -> None:
    """It would be a traceback, or a silent copy of `none`; only `none` changes nothing."""
    with refused(ConfigError, place=f"conf/ablation/{name}.yaml", expected=expected):
        parse_arm(name, text)


@pytest.mark.parametrize("choice", ["../experiment/demo", "missing", ""])
def test_choice_that_is_no_arm_is_refused(choice: str) -> None:
    """No other file is read in an arm's place."""
    with refused(ConfigError, place="ablation", expected="no_qd", got=repr(choice)):
        read_arm(choice)
    with refused(ConfigError, place="ablation"):
        compose([f"ablation={choice}"])


@pytest.mark.parametrize("settings", [{"promts": {"policy": "none"}}, {"seed": {"policy": 1}}])
def test_arm_of_a_setting_that_is_none_is_refused(settings: dict[str, Any]) -> None:
    """A misspelt key is told by its name."""
    with refused(ConfigError, place="ablation=mine", got="which is not a setting"):
        check_change("mine", settings, {"seed": 0, "prompts": {"policy": "uniform"}})


def test_arm_of_a_removed_setting_names_it() -> None:
    """One's own arm of an earlier release: what it set is said to be gone, and what to use."""
    with refused(ConfigError, place="training.seeds", got="training.seeds=3", remedy="tacevo noise"):
        check_change("mine", {"training": {"seeds": 3}}, {"training": {"epochs": 10}})


@pytest.mark.slow
def test_arms_are_pairwise_different_runs() -> None:
    """No two arms share a ledger's first line."""
    told = [str(identity(arm(name))) for name in groups()["ablation"]]
    assert len(set(told)) == len(told)


def test_arm_is_taken_out_of_overrides() -> None:
    """The last choice counts, quoted or not; without a choice the arm is `none`."""
    assert split_arm(["seed=1", "ablation=none", "ablation='no_qd'"]) == ("no_qd", ["seed=1"])
    assert split_arm(["seed=1"]) == ("none", ["seed=1"])


@pytest.mark.few(7)
@pytest.mark.parametrize("name", ARMS)
def test_every_arm_begins_with_the_generation_0_of_none(name: str) -> None:
    """Request for request; all but the model that is asked, or the first temperature, where an arm is about it."""

    def asked(config: RunConfig) -> tuple[Proposal, ...]:
        settings = replace(build_settings(config, Parts.of(config, Decisions(None))), model="m", llm=())
        start = 0.6 if name in OTHER_START else config.temperature.start
        return plan_initial(fakes.TASK, settings, mutations=10, temperature=start)

    assert asked(arm(name)) == asked(arm("none"))


@pytest.mark.few(5)
@pytest.mark.parametrize("name", sorted(set(ARMS) - {"llm_vs_grammar", *OTHER_START}))
def test_generation_0_is_answered_alike_and_then_the_search_is_another(name: str, folder: Path) -> None:
    """Arms share every answer and fitness of generation 0, and then part, but for the one that only stops recording."""
    lines, recorder = searched(name, folder)
    plain, unablated = searched("none", folder)
    assert common(lines, plain, 0)
    assert recorder.lines != unablated.lines
    assert all(common(lines, plain, number) for number in range(7)) == (name == "no_prompt_archive")


def test_without_prompt_archive_every_network_is_that_of_none(folder: Path) -> None:
    """`prompts=uniform` only records: without the record, network archive and fitnesses are the very same."""
    lines, recorder = searched("no_prompt_archive", folder)
    plain, unablated = searched("none", folder)
    assert recorder.states[-1].networks == unablated.states[-1].networks
    recorded = ("prompt_niche", "prompt_status")
    less = [{key: value for key, value in line.items() if key not in recorded} for line in plain]
    assert lines == less
    assert not recorder.states[-1].prompts.trials
    assert unablated.states[-1].prompts.trials


def test_mutation_only_differs_from_the_first_crossover_on(folder: Path) -> None:
    """Until `none` first crosses over, the arm is `none`, parents and prompts included."""
    lines, _ = searched("mutation_only", folder)
    plain, _ = searched("none", folder)
    assert {line["operator"] for line in lines} == {"baseline", "mutation"}
    first = min(line["generation"] for line in plain if line["operator"] == "crossover")
    assert first > 1
    assert all(common(lines, plain, number) for number in range(first))
    assert not common(lines, plain, first)


@pytest.mark.parametrize("name", OTHER_START)
def test_another_first_temperature_is_all_that_differs_in_generation_0(name: str, folder: Path) -> None:
    """Operators, parents and prompts are those of `none`; the temperature stays, but for its jitter."""
    lines, recorder = searched(name, folder)
    plain, _ = searched("none", folder)
    fields = ("id", "operator", "parents", "prompt")
    first, other = (
        [[line[key] for key in fields] for line in run if line["generation"] == 0] for run in (lines, plain)
    )
    assert first == other
    (held,) = {line.temperature for line in recorder.lines if isinstance(line, GenerationLine)}
    assert held == float(name[-1])
    assert all(abs(line["temperature"] - held) <= 0.1 for line in lines[1:])


@pytest.mark.parametrize("name", ["fixed_temperature", "stall_temperature"])
def test_temperature_arms_share_generation_1(name: str, folder: Path) -> None:
    """T_1 is the same under every rule, and so is all that follows from it."""
    lines, recorder = searched(name, folder)
    plain, _ = searched("none", folder)
    assert common(lines, plain, 1)
    assert not common(lines, plain, 6)
    temperatures = [line.temperature for line in recorder.lines if isinstance(line, GenerationLine)]
    assert (len(set(temperatures)) == 1) == (name == "fixed_temperature")


def test_best_of_n_mutates_the_baseline_alone(folder: Path) -> None:
    """No candidate descends from another; prompts, temperatures and draws of mutating generations are those of none."""
    lines, _ = searched("random_parents_only_baseline", folder)
    plain, _ = searched("none", folder)
    assert {tuple(line["parents"]) for line in lines[1:]} == {("g00s00",)}
    shared = [(one, other) for one, other in zip(lines, plain, strict=True) if other["operator"] == "mutation"]
    assert len({one["generation"] for one, _ in shared}) > 2
    assert all((one["prompt"], one["temperature"]) == (other["prompt"], other["temperature"]) for one, other in shared)


@pytest.mark.parametrize("name", ["drift", "best_k"])
def test_control_differs_from_none_in_its_parents_alone(name: str, folder: Path) -> None:
    """Operators, prompts and temperatures are those of `none`, slot by slot; the archive only measures."""
    lines, recorder = searched(name, folder)
    plain, _ = searched("none", folder)
    fields = ("id", "operator", "prompt", "temperature")
    assert [[line[key] for key in fields] for line in lines] == [[line[key] for key in fields] for line in plain]
    pairs = [(line, other) for line, other in zip(lines, plain, strict=True) if line["generation"] == 1]
    same = [line["request"] == other["request"] for line, other in pairs if line["parents"] == other["parents"]]
    assert same
    assert all(same)  # one question in one slot is one request, which both arms share
    assert any(line["parents"] != other["parents"] for line, other in zip(lines, plain, strict=True))
    assert planned(arm(name), folder).networks.niches == planned(arm("none"), folder).networks.niches
    assert recorder.states[-1].networks.bounds is not None


def before_each_generation(recorder: fakes.Recorder) -> Iterator[tuple[list[CandidateLine], int, set[str]]]:
    """Yield what was trained before each generation from 1 on, how many elites there were, and its parents."""
    lines = [line for line in recorder.lines if isinstance(line, CandidateLine)]
    for line, state in zip(recorder.lines, recorder.states, strict=True):
        if isinstance(line, GenerationLine) and line.generation < 6:
            trained = [one for one in lines if one.generation <= line.generation and one.fitness is not None]
            children = [one for one in lines if one.generation == line.generation + 1]
            parents = {parent for child in children for parent in child.parents}
            yield trained, len(state.networks.archive.elites), parents


def test_drift_takes_losers_as_parents(folder: Path) -> None:
    """Parents are trained candidates, also such as no archive took, and such as are worse than most."""
    _, recorder = searched("drift", folder)
    generations = list(before_each_generation(recorder))
    assert all(parents <= {one.id for one in trained} for trained, _, parents in generations)
    rejected = {one.id for trained, _, _ in generations for one in trained if one.status is AddStatus.rejected}
    assert rejected & set().union(*(parents for _, _, parents in generations))


def test_best_k_parents_are_as_many_of_the_fittest_as_there_are_elites(folder: Path) -> None:
    """Whatever niche they lie in: some of them are not elites, and some elites are not among them."""
    _, recorder = searched("best_k", folder)
    for trained, elites, parents in before_each_generation(recorder):
        limit = sorted({one.fitness or 0.0 for one in trained})[:elites][-1]
        assert all((one.fitness or 0.0) <= limit for one in trained if one.id in parents)
    assert recorder.lines != searched("none", folder)[1].lines


def test_random_sampling_has_no_parents(folder: Path) -> None:
    """From generation 1 on, every slot asks for a network at random, at the temperature that it has in `none`."""
    lines, _ = searched("random_sampling", folder)
    plain, _ = searched("none", folder)
    later = [(one, other) for one, other in zip(lines, plain, strict=True) if one["generation"] > 0]
    assert {(one["operator"], tuple(one["parents"]), one["prompt"]) for one, _ in later} == {("sample", (), None)}
    assert all(one["temperature"] == other["temperature"] for one, other in later)


def test_operator_per_candidate_mixes_a_generation(folder: Path) -> None:
    """Both operators occur within one generation; a slot that mutates has the prompt that it would have had in none."""
    lines, _ = searched("crossover_per_candidate", folder)
    plain, _ = searched("none", folder)
    mixed = [{line["operator"] for line in lines if line["generation"] == number} for number in range(1, 7)]
    assert {"mutation", "crossover"} in mixed
    pairs = [(one["prompt"], other["prompt"]) for one, other in zip(lines, plain, strict=True)]
    shared = [(one, other) for one, other in pairs if one is not None and other is not None]
    assert shared
    assert all(one == other for one, other in shared)
    first = [pair for pair in zip(lines, plain, strict=True) if pair[0]["generation"] == 1]
    alike = [one["request"] == other["request"] for one, other in first if one["operator"] == other["operator"]]
    assert alike
    assert all(alike)


def test_best_archive_holds_the_fittest_of_all(folder: Path) -> None:
    """Without niches the archive is the k best distinct fitnesses of everything that was trained."""
    lines, recorder = searched("no_qd", folder)
    fitnesses = sorted({line["fitness"] for line in lines if "fitness" in line})
    kept = recorder.states[-1].networks.archive.elites
    assert sorted(-elite.objective for elite in kept.values()) == fitnesses[:5]
    assert sorted(kept) == list(range(5))
    assert len(fitnesses) > 5
    assert {line["status"] for line in lines if "status" in line} == {status.value for status in AddStatus}


@pytest.mark.parametrize(("name", "axis"), [("arch_div_only", 0), ("eff_ratio_only", 1)])
def test_single_descriptor_places_by_it_alone(name: str, axis: int, folder: Path) -> None:
    """Niches follow from one descriptor: candidates that agree in it share one for every value of the other."""
    plan = planned(arm(name), folder)
    lines, recorder = searched(name, folder)
    networks = recorder.states[-1].networks
    assert networks.bounds is not None
    placed = {
        line["id"]: (line["arch_div"], scaled(line["eff_ratio"], Scale.log))[axis] for line in lines if "niche" in line
    }
    for niche, elite in networks.archive.elites.items():
        point = networks.bounds.normalise((placed[elite.name],))
        assert plan.networks.niche_of(point) == niche  # type: ignore[union-attr]


def test_fixed_bounds_are_those_of_the_axes(folder: Path) -> None:
    """One axis has one pair of bounds, its own; an archive without niches has none."""
    bounds = ["archive.bounds=fixed", "archive.arch_div_bounds=[0.1,0.2]", "archive.eff_ratio_bounds=[10,100]"]
    plans = [planned(arm(name, *bounds), folder) for name in ("none", "arch_div_only", "eff_ratio_only", "no_qd")]
    told = [plan.archive.bounds and (plan.archive.bounds.low, plan.archive.bounds.high) for plan in plans]
    assert told == [((0.1, 1.0), (0.2, 2.0)), ((0.1,), (0.2,)), ((1.0,), (2.0,)), None]


def test_every_arm_is_documented() -> None:
    """The page says of each arm what it changes, what stays common, and why it is asked."""
    page = (ROOT / "docs" / "ablations.md").read_text(encoding="utf-8")
    table = page.partition("| arm |")[2].partition("\n\n")[0]
    assert [name for name in groups()["ablation"] if f"`{name}`" not in table] == []
