"""Promise: no configuration with an impossible value is ever built, and what decides a result is its identity."""

import math
from dataclasses import replace
from typing import Any

import pytest
from refusals import refused

from tacevo.config.checks import check_together
from tacevo.config.comments import comments
from tacevo.config.compose import compose
from tacevo.config.identity import identity, llm_identity
from tacevo.config.plain import from_plain
from tacevo.config.schema import RunConfig, keys
from tacevo.errors import ConfigError
from tacevo.parts.facts import SOURCES
from tacevo.records import to_json
from tacevo.storage.canonical import canonical, leaves

CONFIG = compose([])
HOSTED = compose(["llm=anthropic"])
NAN, INF = math.nan, math.inf


def half(config: RunConfig, group: str, name: str) -> Any:
    """Return half of a number in a configuration."""
    value = getattr(getattr(config, group), name)
    return type(value)(value / 2)


def changed(key: str, value: Any, config: RunConfig = CONFIG) -> RunConfig:
    """Build a configuration that differs in one setting."""
    plain: Any = to_json(config)
    group, _, name = key.rpartition(".")
    (plain[group] if group else plain)[name] = value
    return from_plain(plain)


#: Impossible values of each setting that has a range.
IMPOSSIBLE: dict[str, list[Any]] = {
    "seed": [-1],
    "search.generations": [-1],
    "search.candidates": [0],
    "search.initial": [-1],
    "search.training_flops": [0.0, -1.0, NAN, INF],
    "search.stop_after_unusable": [0, -1],
    "task.class_name": ["", "2D", "a b", "a.b"],
    "task.output_argument": ["", "n-outputs"],
    "task.outputs": [0, -3],
    "task.images": [9],
    "data.image_size": [0, 15, 257],
    "data.seed": [-1],
    "data.sensor_seed": [-1],
    "data.split_seed": [-1],
    "data.validation_part": [0.0, 1.0, -0.1, NAN],
    "data.test_part": [0.0, 1.0, -0.1, 0.9],
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
    "llm.effort": ["", "none", "HIGH", 3],
    "llm.thinking": [0, -1, 4096, True, 1.5, "", "enabled", [1024], {"type": "adaptive"}],
    "llm.budget_usd": [-0.01, NAN, INF],
    "archive.kept": [0],
    "archive.niches": [0, 20_001],
    "archive.prompt_niches": [0, 20_001],
    "archive.arch_div_bounds": [[], [0.0], [0.0, 1.0, 2.0], [1.0, 1.0], [1.0, 0.0], [NAN, 1.0], [0.0, INF]],
    "archive.eff_ratio_bounds": [[1.0, 0.0], [-INF, 0.0]],
    "temperature.start": [-0.1, 1.1, NAN],
    "prompts.pool": [-1, 0],
    "temperature.step": [-0.1, 1.1, NAN],
    "temperature.jitter": [-0.1, 1.1, NAN],
    "proposals.mutation_probability": [-0.1, 1.1, NAN],
    "proposals.skipped": [-0.1, 1.0, NAN],
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
    "llm.label": ["/models/m", "~/m", "file:/models/m", "openai//models/m", "C:\\models\\m", "", "https://host/m"],
}

#: The ends of the ranges, which are possible.
POSSIBLE: dict[str, list[Any]] = {
    "seed": [0],
    "search.generations": [0],
    "search.candidates": [1],
    "search.initial": [0],
    "search.training_flops": [None, 1e-9],
    "search.stop_after_unusable": [None, 1],
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


@pytest.mark.parametrize(("key", "value"), [(key, value) for key in IMPOSSIBLE for value in IMPOSSIBLE[key]])
def test_impossible_value_is_refused_by_its_key(key: str, value: Any) -> None:
    """The error names the key as the user wrote it."""
    with refused(ConfigError, place=key):
        changed(key, value, HOSTED)


@pytest.mark.parametrize(("key", "value"), [(key, value) for key in POSSIBLE for value in POSSIBLE[key]])
def test_ends_of_a_range_are_possible(key: str, value: Any) -> None:
    """Ranges include their ends."""
    assert canonical(identity(changed(key, value)))


@pytest.mark.few(12)
@pytest.mark.parametrize(
    ("overrides", "place", "expected"),
    [
        (["task=grating", "task.outputs=1"], "task.outputs", "at least 2 for classification"),
        (["task.loss=cross_entropy"], "task.loss", "mse for regression"),
        (["task=grating", "task.loss=mse"], "task.loss", "cross_entropy for classification"),
        (["data=folder", "data.root=''"], "data.root", "the directory of the data set for data=folder"),
        (["data=numpy"], "data.root", "the file of the data set for data=numpy"),
        (["data=folder", "data.root=x", "data.image_size=1025"], "data.image_size", "at most 1024 for data=folder"),
        (["data=csv", "data.root=x"], "data.target_columns", "the different columns of the labels"),
        (["archive.niches=30", "archive.samples=29"], "archive.niches", "at most archive.samples=29"),
        (["llm.delivery=batch"], "llm.delivery", "direct for llm=grammar"),
        (["llm.top_p=0.9"], "llm.top_p", "nothing for llm=grammar"),
        (["llm=openai", "llm.model=m", "llm.thinking_tokens=9"], "llm.thinking_tokens", "nothing for llm=openai"),
        (["llm=openai", "llm.model=m", "llm.thinking=disabled"], "llm.thinking", "nothing for llm=openai"),
        (["llm=grammar", "llm.effort=low"], "llm.effort", "nothing for llm=grammar"),
        (
            ["llm=anthropic", "llm.thinking=9", "llm.thinking_tokens=9"],
            "llm.thinking_tokens",
            "null beside llm.thinking",
        ),
        (["llm=openai"], "llm.model", "a model's name"),
        # however binary fractions add up: 1 - 0.7 - 0.3 is above 0 among them
        (["data.validation_part=0.7", "data.test_part=0.3"], "data.test_part", "less than 1 together"),
        (
            ["llm=anthropic", "llm.max_tokens=9", "llm.thinking_tokens=9"],
            "llm.thinking_tokens",
            "below llm.max_tokens=9",
        ),
        (["llm.mode=live", "llm.budget_usd=0"], "llm.budget_usd", "null with llm.mode=live"),
        (
            ["archive.bounds=fixed", "archive.eff_ratio_bounds=[0,9]"],
            "archive.eff_ratio_bounds",
            "low > 0 with archive.eff_ratio_scale=log",
        ),
        (["archive.axes=[]"], "archive.axes", "one axis or more, each once"),
        (["archive.axes=[eff_ratio,arch_div]"], "archive.axes", "one axis or more, each once"),
        (["archive.axes=[depth]"], "archive.axes", "one of arch_div, eff_ratio, or FILE.py:CLASS"),
        (["archive.kind=best", "archive.axes=[arch_div]"], "archive.axes", "with archive.kind=best"),
        (["proposals.parents=baseline"], "proposals.mutation_probability", "1 with proposals.parents=baseline"),
        (["proposals.parents=none"], "proposals.mutation_probability", "1 with proposals.parents=none"),
        (
            ["llm=anthropic", "ablation=random_sampling"],
            "proposals.parents",
            "another one with llm=anthropic, which cannot draw a network at random: llm=grammar can",
        ),
        (["archive.kind=best", "ablation=best_k"], "proposals.parents", "another one with archive.kind=best"),
        *(
            (
                ["proposals.operator_for=candidate", f"proposals.mutation_probability={p_m}"],
                "proposals.operator_for",
                f"generation with proposals.mutation_probability={p_m}",
            )
            for p_m in (0, 1)
        ),
    ],
)
def test_settings_that_do_not_go_together_are_refused(overrides: list[str], place: str, expected: str) -> None:
    """What one setting asks of another is checked, and the error names both."""
    with refused(ConfigError, place=place, expected=expected):
        compose(overrides)


@pytest.mark.few(1)
@pytest.mark.parametrize("source", [source for source in SOURCES if source != "simulated"])
def test_run_of_a_release_can_be_studied_on_other_files(source: str) -> None:
    """A release has all its gratings without a list of them, which no other source has a use for."""
    released = compose(["task=force", "data=tacverse", "data.root=release"])
    check_together(replace(released, data=replace(released.data, source=source, target_columns=("x", "y", "z"))))


def test_address_in_a_message_holds_no_login() -> None:
    """What stands before the @ may be a password."""
    with refused(ConfigError, place="llm.base_url", got='"proxy:99999"'):
        changed("llm.base_url", "https://me:hunter2@proxy:99999")


#: Numbers that decide a run's results; half of each is possible, too.
NUMBERS = {
    "search": ("candidates", "initial"),
    "llm": ("max_tokens", "slip_rate"),
    "archive": ("niches", "prompt_niches", "samples"),
    "temperature": ("start", "step", "jitter"),
    "proposals": ("mutation_probability", "best"),
    "training": ("epochs", "batch_size", "learning_rate", "seconds", "memory_mib"),
    "gate": ("max_parameters", "max_flops", "max_modules", "max_source_bytes", "seconds", "memory_mib"),
}

#: Another possible value of every setting that decides a run's results.
DECIDES: dict[str, Any] = {
    **{f"{group}.{name}": half(CONFIG, group, name) for group, names in NUMBERS.items() for name in names},
    "seed": 1,
    "llm.provider": "anthropic",
    "llm.model": "grammar-1",
    "archive.seed": 1,
    "archive.kind": "best",
    "archive.axes": ["eff_ratio"],
    "archive.bounds": "fixed",
    "archive.arch_div_bounds": [0.0, 2.0],
    "archive.eff_ratio_bounds": [0.0, 5.0],
    "archive.eff_ratio_scale": "linear",
    "temperature.rule": "stall",
    "temperature.carrier": "words",
    "prompts.policy": "curiosity",
    "prompts.pool": 5,
    "prompts.tells": ["failures"],
    "prompts.answer": "edit",
    "proposals.parents": "best",
    "proposals.repair_attempts": 1,
    "proposals.operator_for": "candidate",
    "proposals.skipped": 0.5,
    "proposals.answers": 2,
    "training.fitness": "mean_of_3",
    "numerics.kind": "fast",
}

#: Likewise the settings that only hosted models have.
DECIDES_WHEN_HOSTED: dict[str, Any] = {
    "llm.top_p": 0.9,
    "llm.top_k": 40,
    "llm.stop_sequences": ["END"],
    "llm.thinking_tokens": 1024,
    "llm.effort": "low",
    "llm.thinking": "adaptive",
    "llm.system": "user",
}

#: Another possible value of each setting that only says where a run is computed, watched and written, and how long.
DECIDES_NOTHING: dict[str, Any] = {
    "search.generations": 40,
    "search.training_flops": 1e15,
    "search.stop_after_unusable": None,
    "llm.mode": "replay",
    "llm.delivery": "batch",
    "llm.base_url": "http://localhost:1",
    "llm.concurrency": 16,
    "llm.budget_usd": 5.0,
    "llm.prices": "other.yaml",
    "sandbox.require": "kernel",
    "executor.kind": "ray",
    "executor.workers": 16,
    "tracking.kind": "none",
    "tracking.uri": "sqlite:///other.db",
    "tracking.experiment": "other",
    "store.root": "elsewhere",
    "run.dir": "elsewhere",
}


def test_every_setting_decides_or_does_not() -> None:
    """A new setting must be put into one of the two lists; data enter by their fingerprint, tasks by their text."""
    listed = DECIDES.keys() | DECIDES_WHEN_HOSTED.keys() | DECIDES_NOTHING.keys()
    listed |= {"parts", "code"}  # what a user brought: tests/parts
    listed |= {"llm.label"}  # which stands for the model, below
    listed |= {"llm.space"}  # which decides where there is one: tests/rooms/grammar/test_space.py
    listed |= {"search.networks"}  # whose texts are the task's, in the header: tests/rooms/pairs
    listed |= {"temperature.efforts"}  # which decides with temperature.carrier=effort only: test_carrier_settings.py
    listed |= {"llm.models", "llm.choice"}  # which stand in the place of llm.model: tests/evolution/test_models.py
    listed |= {"archive.kept"}  # which decides with archive.kind=best only, below
    # Of which each needs other settings beside it: tests/training/test_determinism.py.
    listed |= {"training.device", "training.gpu", "training.precision", "training.gpu_memory_mib"}
    listed |= {"training.layout", "training.captured"}
    listed |= {"executor.address", "executor.per_gpu"}  # which go with executor=ray and a GPU only
    groups = {key.partition(".")[0] for key in keys() if "." in key}
    assert {key for key in keys() if key not in groups and not key.startswith(("task.", "data."))} == listed


@pytest.mark.parametrize("key", DECIDES)
def test_setting_that_decides_enters_the_identity(key: str) -> None:
    """A run under another such setting is another run."""
    assert canonical(identity(changed(key, DECIDES[key]))) != canonical(identity(CONFIG))


def test_number_of_places_decides_without_niches_only() -> None:
    """Elsewhere two runs that differ in nothing else are one."""
    for kind, does in {"cvt": False, "best": True}.items():
        config = changed("archive.kind", kind)
        assert (identity(changed("archive.kept", 11, config)) != identity(config)) is does
    told: Any = identity(changed("archive.kind", "best"))["archive"]
    assert (told["kind"], told["kept"]) == ("best", 10)  # also at its default


@pytest.mark.parametrize("key", DECIDES_WHEN_HOSTED)
def test_setting_of_a_hosted_model_enters_the_identity_once_set(key: str) -> None:
    """Set it is part of the run; left alone it is not, so that runs without it stay the runs they were."""
    set_ = identity(changed(key, DECIDES_WHEN_HOSTED[key], HOSTED))["llm"]
    assert set_ == {**llm_identity(HOSTED.llm), key.removeprefix("llm."): DECIDES_WHEN_HOSTED[key]}


def test_label_is_the_model_in_all_that_is_recorded() -> None:
    """A run under a label is the same run, wherever the file of its model lies."""
    runs = [changed("llm.model", path, changed("llm.label", "another", HOSTED)) for path in ("/a/m", "/b/m")]
    assert {canonical(identity(run)) for run in runs} == {canonical(identity(changed("llm.model", "another", HOSTED)))}


def test_identity_without_later_settings_is_golden() -> None:
    """What came after the first version of a ledger leaves no trace in a run that does not use it."""
    assert set(llm_identity(HOSTED.llm)) == {"provider", "model", "max_tokens", "slip_rate"}
    told: Any = identity(CONFIG)
    assert set(told["prompts"]) == {"policy"}
    assert set(told["proposals"]) == {"mutation_probability", "parents", "best"}
    assert not set(told["archive"]) & {"kind", "kept", "axes"}


@pytest.mark.parametrize("key", DECIDES_NOTHING)
def test_setting_that_decides_nothing_stays_out(key: str) -> None:
    """A run elsewhere, on more workers, by batches or for more generations goes on with the same ledger."""
    config = changed(key, DECIDES_NOTHING[key], HOSTED)
    assert config != HOSTED
    assert identity(config) == identity(HOSTED)


def test_every_setting_has_its_words() -> None:
    """`tacevo search --help` and the site show them; a group alone is no setting."""
    settings = [key for key, _ in leaves(to_json(compose(["llm=grammar"])))]
    assert [key for key in settings if not comments().get(key)] == []
