"""Promise: an estimate sends no request, needs no key and makes no file; its hours follow from a measured pace."""

import functools
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from tacevo.choices import Device
from tacevo.cli.app import main
from tacevo.config.compose import compose, compose_estimate
from tacevo.config.schema import RunConfig
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.costs import dollars
from tacevo.errors import ConfigError, RunError, SandboxError, StoreError
from tacevo.evolution.proposals import plan_initial
from tacevo.records import Completion, Delivery, Json, Request, to_json
from tacevo.runs.decisions import Decisions, Parts
from tacevo.runs.estimate import describe_cost, describe_estimates, describe_time, estimate
from tacevo.runs.local import trainings_at_once
from tacevo.runs.pace import GROWTH, Pace, growth, measure, part_saved, training_images, trainings
from tacevo.runs.providers import load_prices
from tacevo.runs.wiring import build_settings
from tacevo.storage.store import Store
from tacevo.text import lasting

pytestmark = pytest.mark.room("simulator", "grammar")

SMALL = [
    "experiment=published_force",
    "llm=anthropic",
    "search.generations=2",
    "search.candidates=10",
    "search.initial=4",
]

Estimating = Callable[..., list[str]]


@pytest.fixture
def overrides(tmp_path: Path) -> Estimating:
    """Return the overrides of a search with an empty store."""
    return lambda *more: [*SMALL, f"store.root={tmp_path}/cache", *more]


def paced(config: RunConfig) -> Pace:
    """Measure nothing: 100 images a second, and a quarter of a second to start."""
    return Pace(at_once=2, images_per_second=100.0, start=0.25, gate=1.5)


def described(config: RunConfig) -> str:
    """Write an estimate down without measuring."""
    return f"{describe_cost(config)}\n\n{describe_time(config, paced, lambda config, images: 0.0)}"


def first_requests(overrides: list[str]) -> list[Request]:
    """Write the requests of generation 0, as a search would."""
    config = compose(overrides)
    task = load_task(config, facts_without_data(config))
    planned = plan_initial(
        task,
        build_settings(config, Parts.of(config, Decisions(None))),
        mutations=config.search.initial,
        temperature=0.6,
    )
    return [proposal.request for proposal in planned if proposal.request is not None]


def record(overrides: list[str], requests: list[Request], *, tokens: tuple[int, int]) -> None:
    """Record answers of so many tokens."""
    store = Store(Path(compose(overrides).store.root), "completions")
    for request in requests:
        completion = Completion(
            text="", model="m", stop_reason="end_turn", input_tokens=tokens[0], output_tokens=tokens[1]
        )
        store.write(to_json(request), to_json(completion))


def test_estimate_needs_no_key_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before any call: status 0, the numbers, and an empty directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ANTHROPIC_API_KEY", raising=False)
    monkeypatch.setattr("tacevo.runs.pace._SECONDS", 0.2)
    assert main(["search", "--estimate", *SMALL, "executor.workers=1"]) == 0
    out = capsys.readouterr().out
    assert "24 requests to claude-haiku-4-5-20251001; the answers to 0 of generation 0 are recorded already." in out
    assert "USD direct" in out
    assert "llm.budget_usd: no limit" in out
    assert re.search(r"hours: about [\d.]+ for 25 trainings of 5 epochs of 480 images of 32 px, with", out)
    assert list(tmp_path.iterdir()) == []


def test_cost_is_told_before_the_hours_are_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Who wants to know the dollars need not wait for it."""

    def measured(config: RunConfig) -> str:
        told = capsys.readouterr()
        assert "USD direct" in told.out
        assert told.err.strip()  # that it measures, before it does
        return "hours"

    monkeypatch.setattr("tacevo.runs.estimate.describe_time", measured)
    assert main(["search", "--estimate", *SMALL]) == 0
    assert capsys.readouterr().out == "hours\n"


def test_estimate_of_a_sweep_has_every_job_and_their_sum(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a key, a model or a directory of the sweep; jobs of another size have another row."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ANTHROPIC_API_KEY", raising=False)
    monkeypatch.setattr("tacevo.runs.estimate.describe_estimates", partial(describe_estimates, measure=paced))
    small = ["data.image_size=32", "training.epochs=1", "executor.workers=1", "search.candidates=10"]
    command = ["experiment=paper_force", *small, "search.initial=4", "search.generations=2,3", "seed=0,1"]
    assert main(["search", "-m", "--estimate", *command]) == 0
    out = capsys.readouterr().out
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in out.splitlines() if line.startswith("| ")]
    assert [row[1] for row in rows[2:]] == ["24", "24", "34", "34", "116"]
    assert len({row[0] for row in rows[2:]}) == 5
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_sum_of_a_sweep_is_that_of_its_jobs_and_measures_a_pace_once(overrides: Estimating) -> None:
    """What is unknown of one job is unknown of all; jobs that train alike are measured together."""
    measured: list[RunConfig] = []

    def pace(config: RunConfig) -> Pace:
        measured.append(config)
        return paced(config)

    jobs = [(str(seed), compose(overrides(f"seed={seed}", "executor.workers=2"))) for seed in range(3)]
    unpriced = ("unpriced", compose(overrides("llm.model=claude-unknown", "training.epochs=2")))

    def cells(table: str) -> list[list[str]]:
        rows = [line.split("|")[1:-1] for line in table.splitlines() if line.startswith("| ")]
        return [[cell.strip().replace(",", "") for cell in row] for row in rows[2:]]

    *each, together = cells(describe_estimates(jobs, pace))
    assert len(measured) == 1
    for column in range(1, 5):
        assert float(together[column]) == pytest.approx(sum(float(row[column]) for row in each), abs=2)
    assert float(together[5]) == pytest.approx(sum(float(row[5]) for row in each), rel=0.02)
    *_, together = cells(describe_estimates([*jobs, unpriced], pace))
    assert len(measured) == 3
    assert (together[1], together[5], together[6]) == ("96", "unknown", "unknown")


@pytest.mark.few(1)
@pytest.mark.parametrize("chosen", [[], ["llm=openai"], ["llm.model=claude-opus-5"]])
def test_estimate_needs_no_choice_of_a_model(chosen: list[str], tmp_path: Path) -> None:
    """Of an experiment that leaves it to the user, nor of a server's model; requests and tokens do not depend on it."""
    paper = ["experiment=paper_force", "data.image_size=32", f"store.root={tmp_path}"]
    estimated, named = (estimate(compose_estimate([*paper, *more])) for more in (chosen, ["llm=anthropic"]))
    assert estimated == named
    told = described(compose_estimate([*paper, *chosen]))
    assert "llm=anthropic" in told or "llm.model=claude-opus-5" in chosen
    assert "1010 requests to" in told
    for wrong in ("llm=opnai", "llm.model="):  # which is not taken for none
        with refused(ConfigError, place=wrong.partition("=")[0]):
            compose_estimate(["experiment=paper_force", wrong])


@pytest.mark.slow
def test_recorded_answers_of_generation_0_cost_nothing(overrides: Estimating) -> None:
    """What is in the store is not asked for; another model's answers have another length, and say nothing."""
    record(overrides(), first_requests(overrides("llm.model=claude-opus-5")), tokens=(7, 7))
    record(overrides(), first_requests(overrides())[:3], tokens=(100, 50))
    estimated = estimate(compose(overrides()))
    assert (estimated.requests, estimated.recorded, estimated.samples) == (24, 3, 3)
    assert (estimated.input_tokens, estimated.output_tokens) == (21 * 100, 21 * 50)
    assert "answers are like the mean of the 3 recorded ones of this model" in described(compose(overrides()))


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("thinking", "most"), [("1000", 1000), ("adaptive", 4096), ("4095", 4096), ("disabled", 0), ("null", 0)]
)
def test_thinking_is_counted_with_each_answer(thinking: str, most: int, overrides: Estimating) -> None:
    """As much as the model may think, and never more than an answer may have in all."""
    plain = estimate(compose(overrides()))
    estimated = estimate(compose(overrides(f"llm.thinking={thinking}", "llm.max_tokens=4096")))
    each = plain.output_tokens / plain.requests
    assert estimated.output_tokens == plain.requests * min(each + most, 4096)
    assert estimated.input_tokens == plain.input_tokens


@pytest.mark.slow
def test_answers_with_another_effort_say_nothing(overrides: Estimating) -> None:
    """Nor do those with another thinking; the older name of a thinking is the same one."""
    for number, chosen in enumerate(["llm.effort=max", "llm.thinking=adaptive", "llm.thinking_tokens=1024"], start=1):
        record(overrides(chosen), first_requests(overrides(chosen))[:number], tokens=(number, number))
    samples = {
        chosen: estimate(compose(overrides(chosen))).samples
        for chosen in ("llm.effort=null", "llm.effort=max", "llm.effort=low", "llm.thinking=1024", "llm.thinking=1025")
    }
    assert list(samples.values()) == [0, 1, 0, 3, 0]


def test_line_that_the_price_table_lacks_is_shown(overrides: Estimating) -> None:
    """For the table that is read, or for one of the user's own where that is not about the server."""
    line = "llama: {input_usd: X, output_usd: Y, "
    assert line in described(compose(overrides("llm.model=llama")))
    told = described(compose(overrides("llm.model=llama", "llm.base_url=http://localhost:1")))
    assert line in told
    assert "llm.prices=FILE" in told


def test_cost_is_shown_for_each_delivery(overrides: Estimating) -> None:
    """Both columns of the table, from the price table and the tokens."""
    estimated = estimate(compose(overrides()))
    prices = load_prices("prices.yaml")
    shown = described(compose(overrides())).splitlines()
    costs = []
    for delivery in Delivery:
        price = prices.price("claude-haiku-4-5", delivery)
        assert price is not None
        costs.append(dollars(price.cost(estimated.input_tokens, estimated.output_tokens)))
    assert [cell.strip() for cell in shown[5].split("|")[3:5]] == costs


@functools.cache
def plain_search() -> str:
    """Write the estimate of a search down, of which no answer is recorded."""
    return described(compose([*SMALL, "store.root=nowhere"]))


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (["llm.model=claude-3-haiku-20240307"], "claude-3-haiku-20240307 is not served from 2026-04-20 on"),
        (["llm.model=llama"], "prices.yaml lacks the price of this model"),
        (["llm.model=llama"], "| unknown    | unknown   |"),
        (["llm=openai", "llm.model=claude-3-haiku"], "| output tokens | USD direct |\n"),  # which takes no batches
    ],
)
def test_what_differs_from_a_plain_search_is_told(changes: list[str], told: str, overrides: Estimating) -> None:
    """Models, prices and deliveries."""
    assert told in described(compose(overrides(*changes)))
    assert told not in plain_search()


@pytest.mark.few(1)
@pytest.mark.parametrize("asked", [{"system": "no model"}, {"model": "claude-haiku-4-5-20251001"}])
def test_entry_that_is_no_completion_is_named(asked: Json, overrides: Estimating) -> None:
    """A mean over answers that cannot be read is not guessed, and the file is named."""
    Store(Path(compose(overrides()).store.root), "completions").write(asked, {"text": "no completion"})
    with refused(StoreError, expected="a value", got="nothing", remedy="delete it"):
        estimate(compose(overrides()))


@pytest.mark.slow
def test_hours_follow_from_the_pace(overrides: Estimating) -> None:
    """By hand: 25 trainings of 5 epochs of 480 images at 100 a second, and what they wait for, shared by 2 workers."""
    config = compose(overrides())
    assert (trainings(config), training_images(config)) == (25, 480)
    seconds = 25 * ((1 + GROWTH / 10) * 5 * 480 / 100 + (0.25 + 1.5) / 2)
    assert paced(config).seconds(config, 480) == pytest.approx(seconds)
    told = described(config)
    assert f"hours: about {seconds / 3600:.2g} for 25 trainings of 5 epochs of 480 images of 32 px" in told
    assert "2 baselines at once, 100 images/s in all; 0.25 s to start a training, 1.5 s in the gate" in told
    assert "busy: " not in told
    busy = describe_time(config, lambda config: replace(paced(config), load=8.5))
    assert "The machine was busy: 8.5 processes" in busy
    grown = [growth(compose(overrides(f"search.generations={number}"))) for number in (0, 10, 20, 40)]
    assert grown == [1.0, 1 + GROWTH / 2, 1 + GROWTH, 1 + GROWTH]


@pytest.mark.slow
def test_cluster_is_so_many_machines_and_a_machine_is_one(overrides: Estimating) -> None:
    """Two measured at once: 64 workers of a cluster are 32 times as fast, and on two cores no faster than two."""
    config = compose(overrides("executor.workers=64"))
    elsewhere = replace(config, executor=replace(config.executor, kind="ray"))
    here = paced(config).seconds(config, 480)
    assert here == paced(config).seconds(compose(overrides("executor.workers=2")), 480)
    assert paced(config).seconds(elsewhere, 480) == pytest.approx(here / 32)
    assert "executor.workers=64 on machines like this one" in described(elsewhere)
    assert "executor.workers=64 on this machine" in described(config)


@pytest.mark.parametrize(
    ("visible", "per_gpu", "together"), [("0,1", 2, 4), ("0,1,2,3", 2, 6), ("5", 1, 1), ("", 4, 1)]
)
def test_workers_of_gpus_train_together_as_far_as_leases_allow(
    visible: str, per_gpu: int, together: int, overrides: Estimating, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of six; one that waits for a GPU trains nothing. Where there is none, one is enough to be told so."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    config = compose(overrides("executor.workers=6"))
    executor, training = replace(config.executor, per_gpu=per_gpu), replace(config.training, device=Device.cuda)
    assert trainings_at_once(replace(config, executor=executor, training=training)) == together


@pytest.mark.slow
def test_hours_count_the_images_of_the_training_split(overrides: Estimating, tmp_path: Path) -> None:
    """What the split does not hold out; a data set without a split of its own has no such hours."""
    config = compose(overrides())
    assert training_images(config) == 480
    assert training_images(compose(overrides("data.validation_part=0.15", "data.test_part=0.6"))) == 150
    released = compose(overrides("data.split=release"))
    assert "hours: not measured (data.split: release, and" in described(released)
    np.savez(tmp_path / "own.npz", images=np.zeros((23, 16, 16, 3), np.uint8), labels=np.zeros((23, 3), np.float32))
    own = ["data=numpy", f"data.root={tmp_path}/own.npz"]
    assert training_images(compose(overrides(*own))) == 19
    assert "19 images" in described(compose(overrides(*own)))


def test_long_search_is_told_what_avx512_would_save(overrides: Estimating) -> None:
    """As measured; not a search of minutes, which it is not measured for, nor one that it saves less than a minute."""
    long, short = compose(overrides("training.epochs=15")), compose(overrides("training.epochs=1"))
    took = paced(long).seconds(long, 480)
    asked: list[tuple[RunConfig, int]] = []

    def told(config: RunConfig, part: float) -> str:
        def saving(config: RunConfig, images: int) -> float:
            asked.append((config, images))
            return part

        return describe_time(config, paced, saving).splitlines()[-1]

    assert told(long, 0.2).startswith(f"numerics=portable512 would save {lasting(0.2 * took)} of it (20%)")
    assert "would save" not in told(long, 59 / took)
    assert asked == [(long, 480)] * 2
    assert "would save" not in told(short, 0.2)
    assert len(asked) == 2


@pytest.mark.parametrize(
    "setting", ["numerics=portable512", "numerics=fast", "executor=ray", "task.baseline=/dev/null"]
)
def test_nothing_is_saved_where_nothing_can_be_chosen(setting: str, overrides: Estimating) -> None:
    """Other numerics, nodes, a baseline that does not train: no reason to stop a search."""
    assert part_saved(compose(overrides(setting)), 480) == 0.0


@pytest.mark.slow
def test_saving_is_measured(overrides: Estimating) -> None:
    """A part of the time, on a CPU with AVX-512; none on others, which are told no error."""
    assert 0 <= part_saved(compose(overrides()), 480) < 1


def test_hours_that_cannot_be_measured_are_said_to_be_so(overrides: Estimating) -> None:
    """Tokens and dollars need no sandbox and no data."""

    def fail(config: RunConfig) -> Pace:
        raise SandboxError("broken")

    assert describe_time(compose(overrides()), fail) == "hours: not measured (broken)"
    assert "USD direct" in describe_cost(compose(overrides()))
    absent = compose(overrides("data=csv", "data.root=/nowhere", "data.target_columns=[a,b,c]"))
    assert "hours: not measured (data.root" in described(absent)


@pytest.mark.slow
def test_baseline_that_does_not_train_has_no_pace(overrides: Estimating, tmp_path: Path) -> None:
    """A rejection takes no time, and would promise a search in seconds."""
    broken = tmp_path / "broken.py"
    broken.write_text("class ImageRegressionCNN(nn.Module):\n    pass\n", encoding="utf-8")
    with refused(RunError, place="the baseline", expected="one that trains", got="construction_failed"):
        measure(compose(overrides(f"task.baseline={broken}")))


@pytest.mark.slow
def test_estimate_after_a_search_on_gratings_knows_its_first_answers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Their requests name the classes, which follow from the simulation's settings."""
    small = ["experiment=published_grating", "search.generations=0", "search.initial=2", "data.images=70"]
    small += ["data.image_size=16", "training.epochs=1", "tracking=none", f"store.root={tmp_path / 'cache'}"]
    assert main(["search", *small, f"run.dir={tmp_path / 'run'}"]) == 0
    assert main(["search", "--estimate", *small]) == 0
    assert "the answers to 2 of generation 0 are recorded already" in capsys.readouterr().out


def test_cost_of_several_models_is_the_sum_of_their_shares(overrides: Estimating) -> None:
    """By their weights, each at its own price, with answers as long as its recorded ones; else it is unknown."""
    table = load_prices("prices.yaml").models
    haiku, opus = "claude-haiku-4-5", next(name for name in table if "opus" in name)
    alone = estimate(compose(overrides()))
    config = compose(overrides(f"llm.models={{{haiku}: 1, {opus}: 3}}"))
    both = estimate(config)
    assert both.input_tokens == pytest.approx(alone.input_tokens)
    expected = sum(
        share * (table[name].input_usd * alone.input_tokens + table[name].output_usd * alone.output_tokens) / 1_000_000
        for name, share in ((haiku, 0.25), (opus, 0.75))
    )
    assert dollars(expected) in describe_cost(config)
    request = first_requests(overrides(f"llm.models=[{opus},{haiku}]"))[0]
    assert request.model in {haiku, opus}
    record(overrides(), [request], tokens=(7, 9))
    share = 0.25 if request.model == haiku else 0.75
    assert estimate(config).input_tokens == pytest.approx(
        (1 - share) * alone.input_tokens + share * 7 * (24 - both.recorded), rel=0.1
    )
    assert "unknown" in describe_cost(compose(overrides(f"llm.models=[{haiku},nobody-knows-me]")))
