"""Promise: no configuration with an impossible value is ever built, and what decides a result is its identity."""

import math
from dataclasses import fields, is_dataclass, replace
from typing import Any

import pytest

from tacevo.choices import (
    ArchiveKind,
    Axis,
    BoundsRule,
    Confinement,
    Numerics,
    OperatorScope,
    ParentPolicy,
    PromptPolicy,
    Provider,
    Scale,
    TemperatureRule,
    Tracking,
)
from tacevo.config.compose import compose
from tacevo.config.identity import identity
from tacevo.config.schema import RunConfig
from tacevo.errors import ConfigError
from tacevo.records import Delivery, Json, Mode
from tacevo.storage.canonical import canonical

CONFIG = compose([])
HOSTED = compose(["llm=anthropic"])
NAN, INF = math.nan, math.inf

#: Impossible values of each setting that has a range.
IMPOSSIBLE: dict[str, list[Any]] = {
    "seed": [-1],
    "search.generations": [-1],
    "search.candidates": [0],
    "search.initial": [-1],
    "task.class_name": ["", "2D", "a b", "a.b"],
    "task.output_argument": ["", "n-outputs"],
    "task.outputs": [0, -3],
    "task.images": [9],
    "data.image_size": [0, 15, 257],
    "data.seed": [-1],
    "data.sensor_seed": [-1],
    "data.split_seed": [-1],
    "data.sensor": [""],
    "data.pattern": [""],
    "data.images": [9],
    "data.spacings_mm": [[], [0.5, 0.5], [0.0], [-1.0], [NAN, 1.0], [1.0, NAN], [INF]],
    "llm.model": [""],
    "llm.max_tokens": [0],
    "llm.concurrency": [0],
    "llm.slip_rate": [-0.1, 1.1, NAN],
    "llm.top_p": [0.0, 1.1, NAN],
    "llm.top_k": [0],
    "llm.stop_sequences": [["END", ""]],
    "llm.thinking_tokens": [0, 4096],
    "llm.budget_usd": [-0.01, NAN, INF],
    "archive.niches": [0, 20_001],
    "archive.prompt_niches": [0, 20_001],
    "archive.arch_div_bounds": [[], [0.0], [0.0, 1.0, 2.0], [1.0, 1.0], [1.0, 0.0], [NAN, 1.0], [0.0, INF]],
    "archive.eff_ratio_bounds": [[1.0, 0.0], [-INF, 0.0]],
    "temperature.start": [-0.1, 1.1, NAN],
    "prompts.pool": [-1, 0],
    "temperature.step": [-0.1, 1.1, NAN],
    "temperature.jitter": [-0.1, 1.1, NAN],
    "proposals.mutation_probability": [-0.1, 1.1, NAN],
    "proposals.best": [0],
    "proposals.repair_attempts": [-1],
    "training.epochs": [0],
    "training.batch_size": [1],
    "training.learning_rate": [0.0, -1.0, NAN, INF],
    "training.seconds": [0.0, NAN, INF],
    "training.memory_mib": [63],
    "gate.max_parameters": [0],
    "gate.max_flops": [0],
    "gate.max_modules": [0],
    "gate.max_source_bytes": [0],
    "gate.seconds": [0.0, NAN, INF],
    "gate.memory_mib": [63],
    "executor.workers": [0],
    "llm.base_url": [
        "",
        "localhost",
        "localhost:8000/v1",
        "ftp://localhost",
        "http://",
        "http:///v1",
        "http://localhost:port",
        "http://localhost:99999",
        "http://[::1",
        "http://local host",
        "http://localhost/v1?model=m",
        "http://localhost/v1#top",
        "http://localhost\n",
    ],
}

#: The ends of the ranges, which are possible.
POSSIBLE: dict[str, list[Any]] = {
    "seed": [0],
    "search.generations": [0],
    "search.candidates": [1],
    "search.initial": [0],
    "data.image_size": [16, 33, 256],
    "llm.slip_rate": [0.0, 1.0],
    "llm.budget_usd": [0.0],
    "archive.niches": [1, 20_000],
    "temperature.start": [0.0, 1.0],
    "prompts.pool": [None, 1],
    "proposals.mutation_probability": [0.0, 1.0],
    "training.epochs": [1],
    "executor.workers": [1],
    "llm.base_url": [None, "http://localhost", "https://me:secret@proxy.example:8443/a/v1/", "http://[::1]:8000"],
}


def changed(key: str, value: Json, config: RunConfig = CONFIG) -> RunConfig:
    """Build a configuration that differs in one setting."""
    group, _, name = key.rpartition(".")
    if not group:
        return replace(config, **{name: value})
    return replace(config, **{group: replace(getattr(config, group), **{name: value})})


def keys(record: Any = CONFIG, prefix: str = "") -> list[str]:
    """List every setting."""
    listed = []
    for field in fields(record):
        value = getattr(record, field.name)
        listed += keys(value, f"{field.name}.") if is_dataclass(value) else [f"{prefix}{field.name}"]
    return listed


@pytest.mark.parametrize(("key", "value"), [(key, value) for key in IMPOSSIBLE for value in IMPOSSIBLE[key]])
def test_impossible_value_is_refused_by_its_key(key: str, value: Json) -> None:
    """The message begins with the key as the user wrote it, and ends with what came."""
    with pytest.raises(ConfigError, match=rf"^{key} needs .*; got "):
        changed(key, value, HOSTED)


@pytest.mark.parametrize(("key", "value"), [(key, value) for key in POSSIBLE for value in POSSIBLE[key]])
def test_ends_of_a_range_are_possible(key: str, value: Json) -> None:
    """Ranges include their ends."""
    assert canonical(identity(changed(key, value)))


def test_message_says_what_was_expected_and_what_came() -> None:
    """A message can be read without the documentation."""
    with pytest.raises(ConfigError, match=r"^data\.image_size needs a value from 16 to 256 for data=simulated; got 8$"):
        changed("data.image_size", 8)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["task=grating", "task.outputs=1"], r"^task\.outputs needs a value >= 2 for classification; got 1"),
        (["task.loss=cross_entropy"], r"^task\.loss needs mse for regression, .*; got 'cross_entropy'"),
        (["task=grating", "task.loss=mse"], r"^task\.loss needs .* cross_entropy for classification; got 'mse'"),
        (
            ["data=csv", "data.target_columns=[a]"],
            r"^data\.root needs the folder of the data set for data=csv; got None",
        ),
        (["data=folder", "data.root=''"], r"^data\.root needs the folder of the data set for data=folder; got ''"),
        (["data=numpy"], r"^data\.root needs the file of the data set for data=numpy; got None"),
        (["data=tacverse"], r"^data\.root needs the folder of the data set for data=tacverse; got None"),
        (
            ["data=folder", "data.root=x", "data.image_size=1025"],
            r"^data\.image_size needs a value from 16 to 1024 for data=folder; got 1025$",
        ),
        (["data=csv", "data.root=x"], r"^data\.target_columns needs the different columns of the labels, .*; got \[\]"),
        (["archive.niches=30", "archive.samples=29"], r"^archive\.niches needs a value from 1 to archive.samples=29"),
        (["llm.delivery=batch"], r"^llm\.delivery needs direct for llm=grammar; got 'batch'"),
        (["llm.top_p=0.9"], r"^llm\.top_p needs to be left out for llm=grammar, which does not know it; got 0.9"),
        (
            ["llm=openai", "llm.model=m", "llm.thinking_tokens=9"],
            r"^llm\.thinking_tokens needs to be left out for llm=op",
        ),
        (["llm=openai"], r"^llm\.model needs a model name; got ''"),
        (
            ["llm=anthropic", "llm.max_tokens=10", "llm.thinking_tokens=10"],
            r"from 1 to below llm\.max_tokens=10; got 10",
        ),
        (["llm.mode=live", "llm.budget_usd=0"], r"^llm\.budget_usd needs null with llm\.mode=live, .*; got 0.0$"),
        (
            ["archive.bounds=fixed", "archive.eff_ratio_bounds=[0,9]"],
            r"^archive\.eff_ratio_bounds needs low > 0 with eff_ratio_scale=log; got 0.0",
        ),
    ],
)
def test_settings_that_do_not_go_together_are_refused(overrides: list[str], message: str) -> None:
    """What one setting asks of another is checked, and the message says which."""
    with pytest.raises(ConfigError, match=message):
        compose(overrides)


def test_address_in_a_message_holds_no_login() -> None:
    """What stands before the @ may be a password."""
    with pytest.raises(ConfigError, match=r"^llm\.base_url needs .*; got 'proxy:99999'$"):
        changed("llm.base_url", "https://me:hunter2@proxy:99999")


def test_config_error_is_a_value_error() -> None:
    """Whoever builds a configuration in Python may catch what Python raises for a wrong value."""
    with pytest.raises(ValueError, match=r"^seed needs"):
        changed("seed", -1)


#: Another possible value of each setting that decides a run's results.
DECIDES: dict[str, Json] = {
    "seed": 1,
    "search.candidates": 9,
    "search.initial": 5,
    "llm.provider": Provider.anthropic,
    "llm.model": "grammar-2",
    "llm.max_tokens": 100,
    "llm.slip_rate": 0.1,
    "archive.niches": 50,
    "archive.prompt_niches": 50,
    "archive.samples": 10_000,
    "archive.seed": 1,
    "archive.kind": ArchiveKind.best,
    "archive.axes": [Axis.eff_ratio],
    "archive.bounds": BoundsRule.fixed,
    "archive.arch_div_bounds": [0.0, 2.0],
    "archive.eff_ratio_bounds": [0.0, 5.0],
    "archive.eff_ratio_scale": Scale.linear,
    "temperature.rule": TemperatureRule.stall,
    "temperature.start": 0.5,
    "temperature.step": 0.1,
    "temperature.jitter": 0.2,
    "prompts.policy": PromptPolicy.curiosity,
    "prompts.pool": 5,
    "proposals.mutation_probability": 0.5,
    "proposals.parents": ParentPolicy.best,
    "proposals.best": 5,
    "proposals.repair_attempts": 1,
    "proposals.operator_for": OperatorScope.candidate,
    "training.epochs": 4,
    "training.batch_size": 16,
    "training.learning_rate": 0.01,
    "training.seconds": 60.0,
    "training.memory_mib": 1024,
    "gate.max_parameters": 1000,
    "gate.max_flops": 1000,
    "gate.max_modules": 100,
    "gate.max_source_bytes": 1000,
    "gate.seconds": 30.0,
    "gate.memory_mib": 1024,
    "numerics.kind": Numerics.fast,
}

#: Likewise the settings that only hosted models have.
DECIDES_WHEN_HOSTED: dict[str, Json] = {
    "llm.top_p": 0.9,
    "llm.top_k": 40,
    "llm.stop_sequences": ["END"],
    "llm.thinking_tokens": 1024,
}

#: Another possible value of each setting that only says where a run is computed, watched and written, and how long.
DECIDES_NOTHING: dict[str, Json] = {
    "search.generations": 40,
    "llm.mode": Mode.replay,
    "llm.base_url": "http://localhost:1",
    "llm.concurrency": 16,
    "llm.budget_usd": 5.0,
    "llm.prices": "other.yaml",
    "sandbox.require": Confinement.kernel,
    "executor.workers": 16,
    "tracking.kind": Tracking.none,
    "tracking.uri": "sqlite:///other.db",
    "tracking.experiment": "other",
    "store.root": "elsewhere",
    "run.dir": "elsewhere",
}


def test_every_setting_decides_or_does_not() -> None:
    """A new setting must be put into one of the two lists; data enter by their fingerprint, tasks by their text."""
    listed = DECIDES.keys() | DECIDES_WHEN_HOSTED.keys() | DECIDES_NOTHING.keys()
    listed |= {"executor.kind", "llm.delivery"}  # of which the default provider has one choice
    listed |= {"archive.kept"}  # which decides with archive.kind=best only, below
    listed |= {"training.device"}  # which needs other settings beside it: tests/training/test_determinism.py
    assert {key for key in keys() if not key.startswith(("task.", "data."))} == listed


@pytest.mark.parametrize("key", DECIDES)
def test_setting_that_decides_enters_the_identity(key: str) -> None:
    """A run under another such setting is another run."""
    assert canonical(identity(changed(key, DECIDES[key]))) != canonical(identity(CONFIG))


def test_places_decide_where_there_are_no_niches() -> None:
    """How many of the best are kept is part of a run that keeps the best, and of no other."""
    more = changed("archive.kept", 11)
    assert identity(more) == identity(CONFIG)
    best = changed("archive.kind", ArchiveKind.best)
    assert identity(changed("archive.kept", 11, best)) != identity(best)


@pytest.mark.parametrize("key", DECIDES_WHEN_HOSTED)
def test_setting_of_a_hosted_model_enters_the_identity_once_set(key: str) -> None:
    """Set it is part of the run; left alone it is not, so that runs without it stay the runs they were."""
    set_ = identity(changed(key, DECIDES_WHEN_HOSTED[key], HOSTED))["llm"]
    assert set_ == {**identity(HOSTED)["llm"], key.removeprefix("llm."): DECIDES_WHEN_HOSTED[key]}


def test_identity_without_later_settings_is_golden() -> None:
    """What came after the first version of a ledger leaves no trace in a run that does not use it."""
    assert set(identity(HOSTED)["llm"]) == {"provider", "model", "max_tokens", "slip_rate"}
    assert set(identity(CONFIG)["prompts"]) == {"policy"}
    assert set(identity(CONFIG)["proposals"]) == {"mutation_probability", "parents", "best"}
    assert not set(identity(CONFIG)["archive"]) & {"kind", "kept", "axes"}


def test_delivery_stays_out_of_the_identity() -> None:
    """A batch asks the same questions, so a run may change its delivery at any time."""
    assert identity(changed("llm.delivery", Delivery.batch, HOSTED)) == identity(HOSTED)


@pytest.mark.parametrize("key", DECIDES_NOTHING)
def test_setting_that_decides_nothing_stays_out(key: str) -> None:
    """A run elsewhere, on more workers or for more generations goes on with the same ledger."""
    assert changed(key, DECIDES_NOTHING[key]) != CONFIG
    assert identity(changed(key, DECIDES_NOTHING[key])) == identity(CONFIG)
