"""The search is the paper's Algorithm 1, and a deterministic fold: same seed, same bytes, however it is executed."""

import itertools
import math
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import fakes
import pytest
from checkout import GOLDEN
from refusals import refused

from tacevo.choices import ModelChoice, Tell
from tacevo.errors import ConfigError, DivergenceError
from tacevo.evolution import instructions
from tacevo.evolution.algorithm import run_search
from tacevo.evolution.lines import CandidateLine, GenerationLine, SearchLine, training_flops
from tacevo.evolution.run_files import line_kind
from tacevo.evolution.state import Budget, Plan
from tacevo.evolution.temperatures import Paper, Stall
from tacevo.evolution.told import Told
from tacevo.parts import Temperature
from tacevo.parts.kinds import PARENTS
from tacevo.parts.registry import of_settings
from tacevo.records import Reason, Rejection, Stage, Training
from tacevo.storage.ledger import Ledger, read_lines


def run(plan: Plan, path: Path | None = None, **changes: object) -> tuple[str, fakes.Recorder]:
    """Run a plan with losses that no seed changes; return its digest, and what an observer saw."""
    return fakes.search(plan, path, **changes)


def candidates(recorder: fakes.Recorder) -> list[CandidateLine]:
    """Return the candidates' lines."""
    return [line for line in recorder.lines if isinstance(line, CandidateLine)]


def generations(recorder: fakes.Recorder) -> list[GenerationLine]:
    """Return the generations' lines."""
    return [line for line in recorder.lines if isinstance(line, GenerationLine)]


#: Ends the search of `fakes.plan(generations=9)` after some of its generations.
BUDGET = Budget(flops=1e6, images=10, epochs=2)

#: Searches with parents of every kind, and with all that a generation may do beside the paper's.
PLANS = {
    **{
        name: fakes.plan(generations=2, parents=of_settings(PARENTS, name, SimpleNamespace(best=2)))
        for name in PARENTS.ours
    },
    "budget": replace(fakes.plan(generations=9), budget=BUDGET),
    "repairs": replace(fakes.plan(), repairs=2),
    "told": fakes.plan(telling=Told(tells=tuple(Tell), edits=True)),
    "models": fakes.plan(models=(("a", 1.0), ("b", 3.0))),
    "bandit": fakes.plan(models=(("a", 1.0), ("b", 1.0)), choice=ModelChoice.bandit),
}

#: With the plan of `skipped`, which needs the room surrogate.
NAMES = [*PLANS, pytest.param("skipped", marks=pytest.mark.room("surrogate"))]


def plan_of(name: str) -> Plan:
    """Return the plan of a name."""
    if name != "skipped":
        return PLANS[name]
    from tacevo.evolution.surrogate import SkipsWorst

    return replace(fakes.plan(generations=8), skipping=SkipsWorst(part=0.5))


@pytest.mark.parametrize("name", NAMES)
def test_many_workers_with_uneven_delays_give_the_digest_of_one(name: str) -> None:
    """Work that finishes in any order is committed in slot order."""
    plan = plan_of(name)
    with ThreadPoolExecutor(8) as executor:
        many, _ = fakes.search(plan, executor=executor, evaluate=fakes.until_killed(10**6))
    assert many == fakes.search(plan)[0]


@pytest.mark.few(5)
@pytest.mark.parametrize("name", NAMES)
def test_run_killed_at_any_training_continues_to_the_same_bytes(name: str, tmp_path: Path) -> None:
    """Whenever it stops, with whatever is at work, the same command ends with the ledger of an uninterrupted run.

    That ledger comes again in a replay; with one rule of parents it stops at every training, else at every sixth.
    """
    plan, whole, trainings = plan_of(name), tmp_path / "whole.jsonl", list[str]()

    def counted(source: str) -> Training | Rejection:
        trainings.append(source)
        return fakes.evaluate(source)

    assert fakes.search(plan, whole, evaluate=counted)[0] == fakes.search(plan, whole)[0]
    for last in range(0, len(trainings), 1 if name == "uniform" else 6):
        path = tmp_path / f"killed{last}.jsonl"
        with ThreadPoolExecutor(8) as executor, pytest.raises(KeyboardInterrupt):
            fakes.search(plan, path, evaluate=fakes.until_killed(last), executor=executor)
        assert path.stat().st_size < whole.stat().st_size
        fakes.search(plan, path)
        assert path.read_bytes() == whole.read_bytes()


def test_longer_run_begins_with_the_lines_of_a_shorter_one(tmp_path: Path) -> None:
    """A finished run can be continued: nothing in its lines depends on how many generations were asked for."""
    path = tmp_path / "ledger.jsonl"
    run(fakes.plan(generations=2), path)
    short = path.read_bytes()
    digest, _ = run(fakes.plan(generations=4), path)
    assert path.read_bytes().startswith(short)
    assert digest == run(fakes.plan(generations=4))[0]


def test_budget_ends_a_search_with_the_generation_that_spends_it(tmp_path: Path) -> None:
    """Not earlier and not later; a run with more of it begins with the same lines."""
    path = tmp_path / "ledger.jsonl"
    plan = PLANS["budget"]
    _, recorder = run(plan, path)
    ended = generations(recorder)
    assert 0 < ended[-1].generation < plan.generations

    def spent(before: int) -> int:
        lines = [line for line in candidates(recorder) if line.fitness is not None and line.generation < before]
        trained = [(line.evaluation or "", line.flops or 0) for line in lines]
        assert len(dict(trained)) < len(trained)  # some networks came twice
        return training_flops(trained, images=BUDGET.images, epochs=BUDGET.epochs)

    assert spent(ended[-1].generation) < BUDGET.flops <= spent(ended[-1].generation + 1)
    short = path.read_bytes()
    run(replace(plan, budget=replace(BUDGET, flops=2 * BUDGET.flops)), path)
    assert path.read_bytes().startswith(short)
    assert len(path.read_bytes()) > len(short)


def test_changed_evaluation_is_a_named_divergence(tmp_path: Path) -> None:
    """A replay that computes something else stops at generation, slot and field."""
    path = tmp_path / "ledger.jsonl"
    run(fakes.plan(), path)

    def drifting(source: str) -> Training | Rejection:
        result = fakes.evaluate(source)
        return result if isinstance(result, Rejection) else replace(result, weights_sha256="2" * 64)

    with refused(DivergenceError, place="g00s00 (generation 0, slot 0), weights", expected="1" * 64, got="2" * 64):
        run(fakes.plan(), path, evaluate=drifting)


def test_one_operator_holds_for_a_whole_generation() -> None:
    """The operator is drawn once a generation; both occur, and generation 0 is the baseline and its mutations."""
    _, recorder = run(fakes.plan(generations=12))
    operators = [
        {line.operator for line in candidates(recorder) if line.generation == generation} for generation in range(13)
    ]
    assert operators[0] == {"baseline", "mutation"}
    assert all(len(used) == 1 for used in operators[1:])
    assert {"mutation"} in operators[1:]
    assert {"crossover"} in operators[1:]


def test_parents_are_elites_of_the_archive_before_the_generation() -> None:
    """No candidate descends from one of its own generation, and every parent held a niche."""
    _, recorder = run(fakes.plan(generations=6))
    elites: set[str] = set()
    for line, state in zip(recorder.lines, recorder.states, strict=True):
        if isinstance(line, GenerationLine):
            elites = {elite.name for elite in state.networks.archive.elites.values()}
        elif isinstance(line, CandidateLine) and line.generation > 0:
            assert set(line.parents) <= elites
            assert len(set(line.parents)) == {"mutation": 1, "crossover": 2}[line.operator]


def test_rejected_candidates_change_no_archive() -> None:
    """What the gate or the training turned away is discarded, and its line says where and why."""
    _, recorder = run(fakes.plan(generations=6))
    before = None
    rejected = 0
    for line, state in zip(recorder.lines, recorder.states, strict=True):
        if isinstance(line, CandidateLine) and line.stage is not None:
            rejected += 1
            assert before is not None
            assert (state.networks, state.prompts.trials) == (before.networks, before.prompts.trials)
            assert line.fitness is None
        before = state
    assert rejected > 3


def test_prompt_archive_records_mutations_after_generation_0_only() -> None:
    """A trial is s = (i, T_g): neither crossover, nor initial mutations, nor the noise of a request enter A_P."""
    _, recorder = run(fakes.plan(generations=8))
    of_generation = {line.generation: line.temperature for line in generations(recorder)}
    for line in candidates(recorder):
        enters = line.operator == "mutation" and line.generation > 0 and line.fitness is not None
        assert (line.prompt_niche is not None) == enters
    final = recorder.states[-1].prompts
    assert final.trials
    for niche, trial in final.trials.items():
        assert trial.temperature == of_generation[int(final.archive.elites[niche].name[1:3])]


def test_curiosity_follows_the_insertions_of_all_mutation_children() -> None:
    """However often a candidate was a parent, its mean curiosity is that of the list of scores, to the last bit."""
    _, recorder = run(fakes.plan(generations=20))
    scores: dict[str, list[float]] = {}
    for line in candidates(recorder):
        if line.fitness is not None:
            assert line.curiosity == (0.5 if line.status == "rejected" else 1 + 1 / (1 + line.fitness))
            taught = line.parents if line.operator == "mutation" else []
            for name in (*taught, line.id):
                scores.setdefault(name, []).append(line.curiosity)
    kept = recorder.states[-1].candidates
    means = {name: math.fsum(values) / len(values) for name, values in scores.items()}
    assert {name: candidate.curiosity for name, candidate in kept.items()} == means


@pytest.mark.slow
def test_states_share_what_they_have_in_common() -> None:
    """Every state of a long search can be kept: one takes no copy of the candidates before it, and none changes."""
    tracemalloc.start()
    try:
        _, recorder = run(fakes.plan(generations=150))
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    trained = 0
    for line, state in zip(recorder.lines, recorder.states, strict=True):
        trained += isinstance(line, CandidateLine) and line.fitness is not None
        assert (len(state.candidates), len(state.networks.history)) == (trained, trained)
    assert trained > 500
    assert kept < 8e6  # bytes; 4.5 million are kept here, and 12.8 million where every state has copies of its own


@pytest.mark.parametrize("rule", [Paper(step=0.05), Stall(step=0.05)])
def test_temperature_follows_the_best_of_the_archive(rule: Temperature) -> None:
    """It never gets worse, so the printed rule climbs by eta to 1; the other falls where it gets better."""
    _, recorder = run(fakes.plan(generations=8, rule=rule))
    lines = generations(recorder)
    assert [line.temperature for line in lines[1:]] == [line.next_temperature for line in lines[:-1]]
    for before, line in itertools.pairwise(lines):
        assert _best(line) <= _best(before)
        falls = isinstance(rule, Stall) and _best(line) < _best(before)
        assert line.next_temperature - line.temperature == pytest.approx(-0.05 if falls else 0.05)


def _best(line: GenerationLine) -> float:
    return math.inf if line.best is None else line.best


def test_prompt_policies_are_other_searches_or_the_same() -> None:
    """Without A_P all networks stay as they are under uniform prompts, where it only records; the abstract's do not."""
    asked = (instructions.Uniform(), instructions.Curious(), instructions.Unrecorded())
    uniform, curious, none = (run(fakes.plan(generations=6, prompts=policy)) for policy in asked)
    assert none[1].states[-1].networks == uniform[1].states[-1].networks != curious[1].states[-1].networks
    assert not none[1].states[-1].prompts.trials


def test_outcomes_are_observed_before_their_line() -> None:
    """A candidate's source can be kept before the ledger names it."""
    order: list[str] = []

    class Ordered(fakes.Recorder):
        def developed(self, outcome: object) -> None:
            order.append("developed")

        def committed(self, line: SearchLine, state: object) -> None:
            order.append(line.kind)

    with Ledger() as ledger:
        run_search(fakes.plan(generations=1), fakes.effects(), ledger, Ordered())
    assert order == [*["developed", "candidate"] * 4, "generation", *["developed", "candidate"] * 6, "generation"]


def test_baseline_that_does_not_train_is_the_users_mistake() -> None:
    """A search cannot begin from nothing; the message says why the baseline failed."""

    def failing(source: str) -> Training | Rejection:
        return Rejection(stage=Stage.train, reason=Reason.not_finite, detail="loss is nan in epoch 1")

    with refused(ConfigError, place="task fake", got="loss is nan in epoch 1"):
        run(fakes.plan(), evaluate=failing)


def test_small_run_is_golden() -> None:
    """The ledger of a small run changes only on purpose: then results change, and the changelog says so."""
    golden = GOLDEN / "ledger.jsonl"
    with Ledger(read_lines(golden, line_kind)) as ledger:
        run_search(fakes.plan(generations=3), fakes.effects(), ledger, fakes.Recorder())
        assert ledger.committed == ledger.recorded


def test_repaired_candidates_are_counted_apart() -> None:
    """A generation's `trained` are first answers; a repaired line tells every answer that was sent back, and why."""
    _, recorder = run(PLANS["repairs"])
    repaired = [line for line in candidates(recorder) if line.repairs]
    assert any(line.fitness is not None for line in repaired)
    for line in repaired:
        assert 1 <= len(line.repairs) <= 2
        assert all((sent.stage, sent.reason) == ("extract", "no_class") for sent in line.repairs)
    for ended in generations(recorder):
        of_generation = [line for line in candidates(recorder) if line.generation == ended.generation]
        trained = [line for line in of_generation if line.fitness is not None]
        assert ended.trained == sum(not line.repairs for line in trained)
        assert (ended.repaired or 0) == sum(bool(line.repairs) for line in trained)
        assert (ended.repaired is not None) == any(line.repairs for line in of_generation)


def test_repairs_leave_first_answers_as_they_are() -> None:
    """Generation 0 with repairs differs from the one without in the rejected slots alone."""
    first = replace(fakes.plan(generations=0), initial=20)
    plain = {line.slot: line for line in candidates(run(first)[1])}
    mended = {line.slot: line for line in candidates(run(replace(first, repairs=1))[1])}
    rejected = {slot for slot, line in plain.items() if line.stage == "extract"}
    assert rejected
    assert {slot for slot in plain if mended[slot].repairs} == rejected
    kept = plain.keys() - rejected
    assert [mended[slot].answer for slot in kept] == [plain[slot].answer for slot in kept]
