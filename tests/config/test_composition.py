"""Promise: every shipped config composes, and a wrong setting is refused with the key as the user wrote it."""

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf
from refusals import refused
from sweeps import composed

from tacevo.choices import SplitRule
from tacevo.config import composition, conf_folder
from tacevo.config.compose import compose, compose_study, spread
from tacevo.config.conf_folder import conf_root, config_roots, groups
from tacevo.config.plain import from_plain
from tacevo.config.schema import RunConfig
from tacevo.config.task_texts import load_task
from tacevo.data.splitting import part_sizes
from tacevo.errors import ConfigError
from tacevo.parts.facts import SOURCES
from tacevo.records import DataFacts, Kind, to_json

#: Arms are composed with every experiment, below.
CHOICES = [(group, choice) for group, choices in groups().items() for choice in choices if group != "ablation"]

#: What a choice needs beside itself.
NEEDED = {
    ("llm", "openai"): ["llm.model=some-model"],
    ("data", "csv"): ["data.root=images", "data.target_columns=[fx,fy,fz]"],
    ("data", "folder"): ["data.root=images"],
    ("data", "tacverse"): ["data.root=images"],
    ("data", "numpy"): ["data.root=images.npz"],
    ("data", "table"): ["data.root=space.zip"],
    ("experiment", "paper_force"): ["llm=anthropic"],
    ("experiment", "paper_grating"): ["llm=grammar"],
}

#: The tasks that are shipped, and how many instructions each has.
MUTATIONS = {"force": 20, "grating": 17, "hardness": 20, "shape": 17}

#: What each arm changes of an experiment that a language model answers.
ARMS = {
    "none": set[str](),
    "no_prompt_archive": {"prompts.policy"},
    "curiosity_prompts": {"prompts.policy"},
    "effect_prompts": {"prompts.policy"},
    "fixed_temperature": {"temperature.rule"},
    "fixed_temperature_0": {"temperature.rule", "temperature.start"},
    "fixed_temperature_1": {"temperature.rule", "temperature.start"},
    "stall_temperature": {"temperature.rule"},
    "no_qd": {"archive.kind"},
    "random_parents_only_baseline": {"proposals.parents", "proposals.mutation_probability"},
    "mutation_only": {"proposals.mutation_probability"},
    "crossover_per_candidate": {"proposals.operator_for"},
    "drift": {"proposals.parents"},
    "best_k": {"proposals.parents"},
    "random_sampling": {"proposals.parents", "proposals.mutation_probability"},
    "arch_div_only": {"archive.axes"},
    "eff_ratio_only": {"archive.axes"},
    "linear_eff_ratio": {"archive.eff_ratio_scale"},
    "tell_fitness": {"prompts.tells"},
    "tell_shuffled": {"prompts.tells"},
    "tell_failures": {"prompts.tells"},
    "tell_best": {"prompts.tells"},
    "tell_notes": {"prompts.tells"},
    "answer_edit": {"prompts.answer"},
    "llm_vs_grammar": {"llm.provider", "llm.model", "llm.slip_rate"},
}


def facts_of(config: RunConfig) -> DataFacts:
    """Describe a data set that fits a task."""
    outputs = config.task.outputs
    names = tuple(config.task.output_names) or tuple(f"class {number}" for number in range(outputs))
    return DataFacts(
        fingerprint="f" * 64,
        kind=config.task.kind,
        counts=(8, 1, 1),
        in_channels=3,
        image_size=64,
        outputs=outputs,
        names=names,
    )


def flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Name every setting of a plain configuration, e.g. `archive.niches`."""
    if not isinstance(value, dict):
        return {prefix: value}
    return {
        key: leaf for name, inner in value.items() for key, leaf in flat(inner, f"{prefix}.{name}".strip(".")).items()
    }


def differing(overrides: list[str]) -> dict[str, Any]:
    """Compose, and return the settings that differ from the defaults."""
    defaults = flat(to_json(composed()))
    return {key: value for key, value in flat(to_json(compose(overrides))).items() if value != defaults[key]}


@pytest.mark.few(16)
@pytest.mark.parametrize(("group", "choice"), CHOICES)
def test_every_shipped_config_composes(group: str, choice: str) -> None:
    """Each choice of each group gives a whole, checked configuration, which run.json holds and gives back."""
    config = composed(f"{group}={choice}", *NEEDED.get((group, choice), []))
    assert from_plain(to_json(config)) == config


def test_every_arm_is_there() -> None:
    """The arms that the issue names, and no other."""
    assert set(groups()["ablation"]) == set(ARMS)


@pytest.mark.few(8)
@pytest.mark.parametrize("ablation", groups()["ablation"])
@pytest.mark.parametrize(
    "experiment", [pytest.param(one, marks=[] if one == "demo" else pytest.mark.slow) for one in groups()["experiment"]]
)
def test_every_ablation_goes_with_every_experiment(ablation: str, experiment: str) -> None:
    """An ablation on top of an experiment changes what the ablation is about, and nothing else."""
    provider = "grammar" if ablation == "random_sampling" else "anthropic"  # only the grammar draws networks
    chosen = [f"llm={provider}", f"experiment={experiment}"]
    if ablation == "linear_eff_ratio":  # the paper's experiments have the linear axis without it
        chosen.append("archive.eff_ratio_scale=log")
    config = composed(*chosen, f"ablation={ablation}")
    assert from_plain(to_json(config)) == config
    plain, ablated = flat(to_json(composed(*chosen))), flat(to_json(config))
    # A setting that came later stands in neither at its default.
    assert {key for key in plain.keys() | ablated.keys() if plain.get(key) != ablated.get(key)} == ARMS[ablation]


def by_hydra(overrides: Sequence[str]) -> Any:
    """Compose a configuration by Hydra's own function, whatever was composed before."""
    GlobalHydra.instance().clear()
    path = ",".join(f"'file://{root}'" for root in config_roots()[1:])
    with initialize_config_dir(str(conf_root()), version_base="1.3"):
        return OmegaConf.to_container(hydra_compose("config", [*overrides, f"hydra.searchpath=[{path}]"]), resolve=True)


@pytest.mark.few(12)
@pytest.mark.parametrize(("group", "choice"), CHOICES)
def test_what_is_composed_is_what_hydra_composes(group: str, choice: str) -> None:
    """Hydra's groups for applications are left out, and files are read once: nothing else differs."""
    overrides = [f"{group}={choice}", *NEEDED.get((group, choice), []), "archive.niches=7", "data.classes=[1,2]"]
    config, _ = composition.composed("config", overrides, config_roots())
    assert OmegaConf.to_container(config, resolve=True) == by_hydra(overrides)


def test_jobs_of_a_sweep_are_composed_as_if_each_was_alone() -> None:
    """Though one composition stands for all seeds; what follows from the seed follows from that of the job."""
    shared = ["experiment=published_grating", "data.sensor_seed=${seed}"]
    jobs = [
        *([f"ablation={arm}", f"seed={seed}"] for arm in ("none", "drift") for seed in (0, 7, 12)),
        *([f"seed={seed}", "data.images=900"] for seed in (3, 0)),
        ["seed=1", "seed=2"],
        [],
    ]
    configs = [compose([*shared, *own]) for own in jobs]
    seeds = [0, 7, 12, 0, 7, 12, 3, 0, 2, 0]
    assert [(config.seed, config.data.sensor_seed) for config in configs] == [(seed, seed) for seed in seeds]
    for config, own in zip(configs[6:], jobs[6:], strict=True):
        assert to_json(config.data).items() <= by_hydra([*shared, *own])["data"].items()
    for wrong in ("seed=-1", "seed=x", "seed=007x"):
        with refused(ConfigError, place="seed"):
            compose([*shared, wrong])
    for seed in (0, 1):
        with refused(ConfigError, place="data.root"):  # which simulated images have no use for
            compose([*shared, f"seed={seed}", "data.root=images"])


def test_file_that_changes_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files are read once as long as they stay the same: one of the user's own that is edited, or goes, is noticed."""
    monkeypatch.setenv("TACEVO_CONFIG_DIR", str(tmp_path))
    mine = tmp_path / "training" / "mine.yaml"
    mine.parent.mkdir()
    for epochs in (3, 12):
        mine.write_text(f"defaults: [quick, _self_]\nepochs: {epochs}\n", encoding="utf-8")
        assert compose(["training=mine"]).training.epochs == epochs
    mine.unlink()
    with refused(ConfigError, place="training"):
        compose(["training=mine"])


@pytest.mark.few(3)
@pytest.mark.parametrize("experiment", [None, "demo", "fast", "published_force", "published_grating", "table"])
def test_efficiency_ratio_is_logarithmic_unless_an_experiment_is_the_papers(experiment: str | None) -> None:
    """What docs/descriptors.md decides by measurement holds for every other search, with bounds that adapt."""
    archive = composed(*([] if experiment is None else [f"experiment={experiment}"])).archive
    assert (archive.eff_ratio_scale.value, archive.bounds.value) == ("log", "adaptive")


EXPERIMENTS = [None, *groups()["experiment"]]


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_lowest_loss_is_the_fitness_unless_an_experiment_is_the_papers(experiment: str | None) -> None:
    """Also of a task of a user's own, without any experiment."""
    chosen = [] if experiment is None else [f"experiment={experiment}", *NEEDED.get(("experiment", experiment), [])]
    is_papers = experiment is not None and experiment.startswith("paper_")
    assert compose(chosen).training.fitness == ("last" if is_papers else "lowest")


def test_last_loss_is_the_fitness_of_the_papers_training() -> None:
    """Where a user names it, with or without a task."""
    assert compose(["training=paper", "task=hardness"]).training.fitness == "last"


def test_demo_is_small() -> None:
    """The demo asks for few candidates, small images and a short training."""
    config = composed("experiment=demo")
    candidates = 1 + config.search.initial + config.search.generations * config.search.candidates
    assert candidates <= 60
    assert config.data.image_size <= 32
    assert part_sizes(config.data.images or 0, (config.data.validation_part, config.data.test_part)) == (400, 200, 1400)
    assert config.training.epochs <= 5
    assert config.llm.provider == "grammar"


def test_fast_search_trains_at_most_as_many_epochs_for_more_answers() -> None:
    """It may end a generation earlier, and never costs more; what it skips is not known before."""
    searches = [composed(f"experiment={name}") for name in ("published_ablation", "fast")]
    networks = [1 + one.search.initial + one.search.generations * one.search.candidates for one in searches]
    usual, fast = (one.training.epochs * count for one, count in zip(searches, networks, strict=True))
    assert networks[1] >= 1.9 * networks[0]
    assert usual - searches[1].training.epochs * searches[1].search.candidates < fast <= usual


def test_images_follow_the_task() -> None:
    """Choosing a task chooses its number of images; a number that the user gives wins."""
    assert compose(["task=grating"]).data.images == 3507
    assert compose(["task=grating", "data.images=100"]).data.images == 100


@pytest.mark.parametrize(
    ("override", "settings"),
    [
        ("seed=3", {"seed": 3}),
        ("temperature=stall", {"temperature.rule": "stall"}),
        ("data.light=dim", {"data.light": "dim"}),
        ("archive.arch_div_bounds=[0.25,0.5]", {"archive.arch_div_bounds": [0.25, 0.5]}),
    ],
)
def test_override_changes_what_it_names(override: str, settings: dict[str, Any]) -> None:
    """An override has its effect and no other."""
    assert differing([override]) == settings


def test_each_source_has_its_own_split() -> None:
    """The release is split as its authors do, everything else at random, unless the user says otherwise."""
    splits = {source: composed(f"data={source}", *NEEDED.get(("data", source), [])).data.split for source in SOURCES}
    assert splits == {source: "release" if source == "tacverse" else "random" for source in SOURCES}
    large = compose(["data=tacverse", "data.root=images", "data.split=random", "data.image_size=1024"]).data
    assert (large.split, large.image_size) == (SplitRule.random, 1024)


@pytest.mark.few(5)
@pytest.mark.parametrize(
    ("override", "place", "expected", "got"),
    [
        ("seed=abc", "seed", "an integer", '"abc"'),
        ("search.generations=1.5", "search.generations", "an integer", "1.5"),
        ("seed=null", "seed", "an integer", "null"),
        ("seed=???", "", "", "Missing mandatory value: seed"),
        ("search=5", "search", "settings of its own", "5"),
        ("archive.eff_ratio_bounds=[a,b]", "archive.eff_ratio_bounds.0", "a number", '"a"'),
        ("llm.mode=replai", "llm.mode", "'live', 'record' or 'replay'", '"replai"'),
        ("data.skip_missing=maybe", "data.skip_missing", "true or false", '"maybe"'),
        ("data={seed:x}", "data.seed", "an integer", '"x"'),
        ("task=forse", "task", "one of force, grating, hardness", "forse"),
        (
            "experiment=dem",
            "experiment",
            "one of demo, fast, paper_force, paper_grating, published_ablation, published_force",
            "dem",
        ),
        ("+search.extra=1", "", "KEY=VALUE", "'+search.extra=1'"),
        ("seed", "", "KEY=VALUE", "'seed'"),
        ("hydra.job.name=x", "", "KEY=VALUE", "'hydra.job.name=x'"),
        ("seed=1,2", "", "one value", "seed=1,2"),
        ("data.root=~/photos", "", "", "~/photos"),
    ],
)
def test_wrong_override_is_refused_as_the_user_wrote_it(override: str, place: str, expected: str, got: str) -> None:
    """A wrong type, an impossible value, an unknown choice: one line that names it."""
    with refused(ConfigError, place=place, expected=expected, got=got):
        compose([override])


@pytest.mark.few(5)
@pytest.mark.parametrize(
    ("override", "place", "remedy"),
    [
        ("search.generatons=3", "search.generatons", "did you mean search.generations?"),
        ("serch.generations=3", "serch.generations", "did you mean search.generations?"),
        ("data={sed:1}", "data.sed", "did you mean data.seed?"),
        ("seed.x=1", "seed.x", "did you mean seed?"),
        ("search.candidate=1", "search.candidate", "did you mean search.candidates?"),
        *(
            (f"{key}=1", key, f"the settings of {key.partition('.')[0]} are {one}")
            for key, one in [
                ("search.batch", "search.generations, search.candidates, "),
                ("data.cache", "data.source, "),
                ("training.lr", "training.epochs, training.batch_size, "),
                ("run.name", "run.dir"),
            ]
        ),
        ("quux=1", "quux", "`tacevo search --help` lists the settings"),
    ],
)
def test_misspelt_key_is_answered_with_the_near_one(override: str, place: str, remedy: str) -> None:
    """An unknown key is never set in silence."""
    with refused(ConfigError, place=place, got="not a setting", remedy=remedy):
        compose([override])


@pytest.mark.few(1)
@pytest.mark.parametrize("override", ["llm.model=5", "run.dir=2026", "data.target_columns=[0,1]"])
def test_number_as_text_needs_quotes(override: str) -> None:
    """Hydra reads 1e3 as 1000.0, so a name that looks like a number could become another."""
    with refused(ConfigError, place=override.partition("=")[0], expected="text", remedy="in quotes"):
        compose([override])
    assert compose(["llm=openai", "llm.model='5'"]).llm.model == "5"


@pytest.mark.parametrize("name", groups()["task"])
def test_every_task_is_read_whole(name: str) -> None:
    """Each task has its baseline, a filled-in system prompt and as many instructions as the paper lists."""
    config = composed(f"task={name}")
    task = load_task(config, facts_of(config))
    assert f"class {config.task.class_name}" in task.baseline
    assert "$" not in task.system
    outputs = f"{config.task.output_argument}={config.task.outputs}"
    assert f"`def __init__(self, in_channels=3, {outputs})`" in task.system
    assert "`(N, 3, 64, 64)`" in task.system
    texts = {instruction.text for instruction in task.instructions}
    assert len(texts) == len(task.instructions) == MUTATIONS[name]
    assert all(text.endswith(".") and "\n" not in text for text in texts)
    assert (task.contract.image_size, task.contract.outputs) == (64, config.task.outputs)


def test_every_file_of_the_library_belongs_to_a_task() -> None:
    """No text lies about that no task names, nor an experiment that has other texts."""
    tasks = [*(composed(f"task={name}").task for name in groups()["task"]), composed("experiment=space").task]
    named = {name for task in tasks for name in (task.baseline, task.instructions, task.system)}
    root = conf_root()
    there = {str(path.relative_to(root)) for path in (root / "library").rglob("*.*") if path.suffix != ".pyc"}
    published = {name for name in there if "/published/" in name}  # tests/rooms/motifs/test_rebuilt_variants.py
    given = {f"library/tacverse/{name}.py" for name in ("resnet18", "convnext_tiny", "vit_small")}
    assert there - published - given - {"library/README.md", "library/grating/by_hand.py"} == named


def test_package_without_configs_is_to_be_installed_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is missing is named by its place."""
    monkeypatch.setattr(conf_folder, "__file__", str(tmp_path / "tacevo" / "config" / "folder.py"))
    with refused(ConfigError, place=str(tmp_path / "tacevo" / "conf"), got="nothing", remedy="install tacevo again"):
        conf_root()


def test_data_of_another_kind_or_shape_are_refused() -> None:
    """Class numbers are not forces, even where their number fits; the number is compared before any training."""
    config = composed("task=force")
    facts = replace(facts_of(config), outputs=2, names=("left", "right"))
    with refused(ConfigError, place="task.outputs", expected="2, as the data set has (left, right)", got="3"):
        load_task(config, facts)
    with refused(ConfigError, place="task.kind", expected="classification", got="regression"):
        load_task(config, replace(facts_of(config), kind=Kind.classification))


def test_pool_larger_than_the_library_is_refused() -> None:
    """The size of the prompt pool goes up to the number of the task's instructions, which the message names."""
    config = composed("task=grating", "prompts.pool=17")
    assert load_task(config, facts_of(config)).instructions
    larger = compose(["task=grating", "prompts.pool=18"])
    with refused(ConfigError, place="prompts.pool", expected="at most 17, the number of the task's", got="18"):
        load_task(larger, facts_of(larger))


def with_file(path: Path, key: str, content: bytes) -> RunConfig:
    """Write a file, and give a force task that names it."""
    path.write_bytes(content)
    config = composed("task=force")
    change: dict[str, Any] = {key: str(path)}
    return replace(config, task=replace(config.task, **change))


@pytest.mark.parametrize("content", [None, b"\xff\x80"])
@pytest.mark.parametrize("key", ["baseline", "instructions", "system"])
def test_unreadable_file_of_a_task_is_named(key: str, content: bytes | None, tmp_path: Path) -> None:
    """A file that is missing, or is not UTF-8, is refused with its path."""
    config = with_file(tmp_path / "file", key, content or b"")
    if content is None:
        (tmp_path / "file").unlink()
    with refused(ConfigError, place=f"task.{key}", expected="a text file", got=str(tmp_path / "file")):
        load_task(config, facts_of(config))


@pytest.mark.parametrize(
    ("library", "place"),
    [
        ({}, "crossover"),
        ([], ""),
        ({"crossover": "Combine.", "mutations": [], "mutation": []}, "mutation"),
        ({"crossover": "Combine.", "mutations": {}}, "mutations"),
        ({"crossover": "Combine.", "mutations": []}, "mutations"),
        ({"crossover": "Combine.", "mutations": ["Widen."]}, "mutations.0"),
        ({"crossover": "Combine.", "mutations": [{"id": "a", "text": " "}]}, "mutations.0"),
        ({"crossover": "Combine.", "mutations": [{"id": "a", "text": "b"}] * 2}, "mutations"),
        (b"crossover: [", ""),
    ],
)
def test_malformed_library_is_refused(library: Any, place: str, tmp_path: Path) -> None:
    """The error names the key, the file and the entry."""
    content = library if isinstance(library, bytes) else yaml.safe_dump(library).encode()
    path = tmp_path / "library.yaml"
    config = with_file(path, "instructions", content)
    with refused(ConfigError, place=f"task.instructions, {path}" + (f", {place}" if place else "")):
        load_task(config, facts_of(config))


def test_unknown_placeholder_is_refused(tmp_path: Path) -> None:
    """A system prompt may use only the names that the code fills in."""
    config = with_file(tmp_path / "system.md", "system", b"Write $klass.")
    with refused(ConfigError, place="task.system", got="$klass"):
        load_task(config, facts_of(config))


def test_configuration_of_an_older_run_is_read() -> None:
    """A run.json from before there were prices, budgets, repairs and axes stands for a run without them."""
    plain: Any = to_json(composed())
    later = {"delivery", "top_p", "top_k", "stop_sequences", "thinking_tokens", "budget_usd", "prices"}
    later |= {"repair_attempts", "operator_for", "axes", "training_flops", "skipped"}
    older = {
        group: {key: value for key, value in settings.items() if key not in later}
        if isinstance(settings, dict)
        else settings
        for group, settings in plain.items()
    }
    assert set(older["llm"]) < set(plain["llm"])
    assert from_plain(older) == composed()


#: Settings that were removed, with what they were by default, and values that were removed.
REMOVED_SETTINGS: dict[str, Any] = {
    "archive.reevaluated": 0.25,
    "proposals.population": 100,
    "proposals.tournament": 25,
    "training.seeds": 1,
}
REMOVED_VALUES = ["archive.kind=extract", "proposals.parents=tournament"]
REMOVED_CHOICES = ["archive=extract", "ablation=extract", "ablation=regularised_evolution", "ablation=three_seeds"]


def recorded_with(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration as run.json has it, with further settings."""
    plain: dict[str, Any] = {**to_json(composed())}
    for key, value in settings.items():
        group, name = key.split(".")
        plain[group][name] = value
    return plain


def test_removed_setting_that_says_nothing_is_read() -> None:
    """A run.json of a release that had it stands for the same run."""
    assert from_plain(recorded_with(REMOVED_SETTINGS)) == composed()


def test_size_beside_what_was_not_chosen_says_nothing() -> None:
    """One command set the sizes of all arms of a sweep; those of the others are read."""
    sizes = {"archive.reevaluated": 0.5, "proposals.population": 20, "proposals.tournament": 5}
    assert from_plain(recorded_with(sizes)) == composed()


@pytest.mark.parametrize("what", [*(f"{key}={value}" for key, value in REMOVED_SETTINGS.items()), *REMOVED_VALUES])
def test_removed_setting_is_refused_by_name(what: str) -> None:
    """On a command line whatever its value, with what to use instead."""
    key, _, value = what.partition("=")
    for override in (what, f"{key.partition('.')[0]}={{{key.partition('.')[2]}: {value}}}"):
        with refused(ConfigError, place=key, got=key, expected="a setting of this release"):
            composed(override)


@pytest.mark.parametrize("what", [*REMOVED_VALUES, "training.seeds=3"])
def test_recorded_run_that_used_what_was_removed_is_refused_by_name(what: str) -> None:
    """It cannot be read as if it were another run."""
    key, _, value = what.partition("=")
    with refused(ConfigError, place=key, got=what, expected="a setting of this release"):
        from_plain(recorded_with({key: int(value) if value.isdigit() else value}))


@pytest.mark.parametrize("value", ["5", None, [5], True, 5.0])
def test_removed_setting_is_not_a_place_for_other_values(value: Any) -> None:
    """Nothing but a whole number, which it was, is passed over."""
    with refused(ConfigError, place="proposals.population"):
        from_plain(recorded_with({"proposals.population": value}))


@pytest.mark.parametrize("what", REMOVED_CHOICES)
def test_removed_choice_is_refused_by_name(what: str) -> None:
    """Of a group of configs, or an arm."""
    group, _, name = what.partition("=")
    with refused(ConfigError, place=group, got=name, expected="a setting of this release"):
        composed(what)


@pytest.mark.parametrize("override", ["data.root=${oc.env:ABSENT}", "seed=${ABSENT}", "archive={niches: ${ABSENT:1}}"])
def test_value_that_cannot_be_found_is_refused(override: str) -> None:
    """Of a variable, of another setting or of no resolver; also in the settings of a study."""
    with refused(ConfigError, got="ABSENT"):
        compose([override])
    with refused(ConfigError, place="run", got="ABSENT"):
        compose_study(["run=${oc.env:ABSENT}"])


def test_recorded_configuration_asks_nothing_of_its_reader() -> None:
    """A stranger's run.json cannot read variables of the environment: `${...}` is text like any other."""
    plain = to_json(composed())
    recorded = from_plain({**plain, "store": {"root": "${oc.env:HOME}"}})
    assert recorded.store.root == "${oc.env:HOME}"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("sed", 1),
        ("seed", "0"),
        ("seed", -1),
        ("llm.mode", "tape"),
        ("sandbox.require", "Confinement.none"),
        ("numerics.kind", "Numerics.fast"),
        ("data.skip_missing", "no"),
        ("training.epochs", 1.0),
    ],
)
def test_recorded_configuration_has_one_spelling(key: str, value: Any) -> None:
    """What was edited, or reads as a setting to one reader and as another to the next, is refused by its key."""
    recorded: Any = to_json(composed())
    *above, name = key.split(".")
    inner = recorded[above[0]] if above else recorded
    inner[name] = value
    with refused(ConfigError, place=key):
        from_plain(recorded)


@pytest.mark.few(4)
@pytest.mark.parametrize("value", [r"^(\w+)/press(\d+)_", "[a", "a=b", '"x', "{x", "$HOME/[a", "a: b)"])
@pytest.mark.parametrize("read", [compose, spread])
def test_text_that_hydra_cannot_read_is_shown_as_a_shell_takes_it(
    value: str, read: Callable[[Sequence[str]], object]
) -> None:
    """What the message shows composes to the text."""
    with pytest.raises(ConfigError) as caught:
        read(["task=force", "data=folder", f"data.root={value}"])
    assert (caught.value.place, caught.value.got) == ("data.root", value)
    typed = caught.value.remedy[caught.value.remedy.rindex("write ") + len("write ") :]
    (override,) = shlex.split(typed)
    assert compose(["task=force", "data=folder", override]).data.root == value


@pytest.mark.parametrize("override", ["seed =1", "data..root=3", "1x=3"])
def test_key_that_hydra_cannot_read_is_no_setting(override: str) -> None:
    """Its value is not blamed."""
    with refused(ConfigError, place=override.partition("=")[0], got="not a setting"):
        compose([override])


def test_linked_and_dangling_files_and_variables_are_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A directory may be a link, an editor leaves links to nothing, and a choice may be named by the environment."""
    elsewhere, own = tmp_path / "elsewhere", tmp_path / "own"
    elsewhere.mkdir()
    own.mkdir()
    (own / "training").symlink_to(elsewhere)
    (elsewhere / ".#mine.yaml").symlink_to(tmp_path / "nothing")
    monkeypatch.setenv("TACEVO_CONFIG_DIR", str(own))
    for epochs in (3, 12):
        (elsewhere / "mine.yaml").write_text(f"defaults: [quick, _self_]\nepochs: {epochs}\n", encoding="utf-8")
        assert compose(["training=mine"]).training.epochs == epochs
    for task in ("force", "grating"):
        monkeypatch.setenv("CHOSEN_TASK", task)
        assert compose(["task=${oc.env:CHOSEN_TASK}"]).task.name == task
