"""Promise: a setting of data that the chosen source does not use is refused where a user sets it, and only there."""

import json
from dataclasses import fields

import pytest
from refusals import refused

from tacevo.config import arms
from tacevo.config.compose import compose, compose_elsewhere
from tacevo.config.schema import DataConfig
from tacevo.config.sources import are_grouped, check_used
from tacevo.errors import ConfigError
from tacevo.parts import kinds
from tacevo.parts.facts import SOURCES
from tacevo.records import Json, to_json

#: What each source cannot do without.
NEEDED = {
    "simulated": [],
    "csv": ["data.root=mine", "data.target_columns=[a,b,c]"],
    "folder": ["data.root=mine"],
    "tacverse": ["data.root=mine"],
    "numpy": ["data.root=mine.npz"],
    "table": ["data.root=mine.zip"],
}

#: Another value of every setting than its default for any source.
OTHER: dict[str, Json] = {
    "image_size": 64,
    "images": 77,
    "seed": 5,
    "sensor_seed": 5,
    "light": "dim",
    "spacings_mm": [1.0, 2.0],
    "root": "other",
    "table": "other.csv",
    "image_column": "path",
    "target_columns": ["x"],
    "sensor": "TacTip",
    "pattern": "Blackdot",
    "skip_missing": True,
    "split_seed": 5,
    "normalisation": "unit",
    "validation_part": 0.2,
    "test_part": 0.2,
    "white_point": 4095.0,
    "group_column": "press",
    "group_pattern": "press",
    "select": True,
    "classes": "joint",
    "test_sensor": "TacTip",
    "shots": 5,
    "gel_mm": 1.5,
    "sensor_column": "1",
    "split_column": "2",
}

#: The settings that need one that names the sensor of each image, of recordings that a user lays out.
NAMED = {"sensor", "test_sensor", "shots"}

#: The settings that depend on the task or on the split beside the source, and where each has no effect.
BUT = {
    "spacings_mm": ["task=force", "data.select=false"],
    "images": ["data.select=false"],
    "pattern": ["task=force", "task=hardness"],
    "classes": ["task=force"],
    "skip_missing": ["task=grating"],
    "group_pattern": ["data.split=release", "task=grating"],
    "test_sensor": ["data.split=random"],
    "shots": ["data.split=release"],
    **{name: ["data.split=release"] for name in ("split_seed", "validation_part", "test_part")},
}


def written(name: str) -> str:
    """Write an override of a setting with its other value."""
    return f"data.{name}={json.dumps(OTHER[name])}"


def test_every_setting_and_source_is_in_the_table() -> None:
    """None was forgotten, and none is used by no source."""
    names = {field.name for field in fields(DataConfig)}
    assert OTHER.keys() == names - {"source", "split"}
    assert SOURCES.keys() == kinds.SOURCES.ours.keys()
    assert frozenset[str]().union(*(facts.uses for facts in SOURCES.values())) == names


def command(source: str, *names: str) -> list[str]:
    """Return overrides that choose a source and set some settings of data to other values."""
    task = "force" if {"skip_missing", "group_pattern"} & set(names) else "grating"
    split = "release" if "test_sensor" in names and source == "tacverse" else "random"
    return [f"task={task}", f"data={source}", *NEEDED[source], f"data.split={split}", *map(written, names)]


@pytest.mark.few(2)
@pytest.mark.parametrize("source", SOURCES)
def test_what_a_source_uses_can_be_set(source: str) -> None:
    """All of it at once, but for what excludes another."""
    names = [name for name in OTHER if name in SOURCES[source].uses]
    gratings, of_release = {"pattern", "spacings_mm", "classes"}, {"test_sensor", "shots"}
    of_random = {"split_seed", "validation_part", "test_part"}
    if "sensor_column" in SOURCES[source].uses:
        of_release, of_random = {"split_column"}, of_random | NAMED
    for others in (
        gratings | of_release | {"group_pattern"},
        gratings | of_release | {"group_column"},
        of_random | {"group_column", "group_pattern", "skip_missing"},
    ):
        chosen = [name for name in names if name not in others]
        data = to_json(compose(command(source, *chosen)).data)
        assert {name: data[name] for name in chosen} == {name: OTHER[name] for name in chosen}


@pytest.mark.few(2)
@pytest.mark.parametrize("source", SOURCES)
def test_what_a_source_does_not_use_is_refused(source: str) -> None:
    """Every setting of every source; the message names the setting and its value."""
    config = compose(command(source))
    usual = to_json(config.data)
    names = OTHER.keys() - SOURCES[source].uses
    assert names
    for name in names:
        got = json.dumps(OTHER[name], separators=(",", ":"))
        with refused(ConfigError, place=f"data.{name}", expected="no value without", got=got, remedy="remove it"):
            check_used(config, {**usual, name: OTHER[name]}, usual)


@pytest.mark.parametrize("source", ["csv", "folder", "numpy"])
def test_sensors_need_what_names_them(source: str) -> None:
    """A column, an array or a level of directories; where the command names one and no sensor, all are taken."""
    settings = [f"data={source}", *NEEDED[source], "task=force"]
    for name in NAMED - {"shots"}:
        with refused(ConfigError, place=f"data.{name}", expected="no value without data.sensor_column"):
            compose([*settings, written(name)])
    assert compose([*settings, "data.sensor_column=1"]).data.sensor == "*"
    run = compose([*settings, "data.sensor_column=1", "data.sensor=A+B"])
    assert run.data.sensor == "A+B"
    assert compose_elsewhere(run, ["data.split_seed=1"]).data.sensor == "A+B"
    assert compose_elsewhere(run, ["data.test_sensor=A"]).data.test_sensor == "A"
    with refused(ConfigError, place="data.split_seed", expected="data.split_column=null"):
        compose([*settings, "data.split_column=2", "data.split_seed=3"])
    assert compose([*settings, "data.split_column=2", "data.split=release"]).data.split == "release"
    with refused(ConfigError, place="data.split", expected="random where no data.split_column"):
        compose([*settings, "data.sensor_column=1", "data.split=release"])
    with refused(ConfigError, place="data.split_column", expected="another one"):
        compose([*settings, "data.sensor_column=1", "data.split_column=1"])


def test_level_of_directories_is_a_number() -> None:
    """As 1 for the directories in data.root."""
    with refused(ConfigError, place="data.sensor_column", expected="a level of directories"):
        compose(["data=folder", "task=grating", *NEEDED["folder"], "data.sensor_column=sensor"])


@pytest.mark.parametrize(("source", "name"), [("simulated", "root"), ("folder", "group_column")])
def test_command_with_such_a_setting_is_refused(source: str, name: str) -> None:
    """As the user wrote it, before any file is looked at."""
    with refused(ConfigError, place=f"data.{name}", expected="no value without"):
        compose(command(source, name))


@pytest.mark.few(4)
@pytest.mark.parametrize(("name", "where"), [(name, where) for name, each in BUT.items() for where in each])
def test_setting_that_needs_a_task_or_a_split_is_refused_without(name: str, where: str) -> None:
    """A pattern of force images, or the seed of a split that the release names."""
    with refused(ConfigError, place=f"data.{name}", expected="no value without"):
        compose(["data=tacverse", *NEEDED["tacverse"], where, written(name)])


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("overrides", "name", "lacking"),
    [
        (["task=force", "data=simulated"], "spacings_mm", "task=grating"),
        (["task=force", "data=tacverse", "data.select=false"], "spacings_mm", "task=grating and data.select=true"),
        (["task=grating", "data=tacverse", "data.select=false"], "spacings_mm", "data.select=true"),
        (["task=force", "data=csv", "data.split=release"], "group_pattern", "data.split=random"),
        (["task=grating", "data=folder", "data.split=release"], "group_pattern", "data.split=random"),
        (["task=shape", "data=tacverse"], "skip_missing", "a task that TacVerse lists in a table"),
        (["task=force", "data=numpy"], "group_column", "data=csv"),
    ],
)
def test_error_asks_for_what_is_lacking_and_no_more(overrides: list[str], name: str, lacking: str) -> None:
    """Nothing of another source, and nothing that is there; with all of it the setting is taken."""
    source = overrides[1].removeprefix("data=")
    with refused(ConfigError, place=f"data.{name}", expected=f"no value without {lacking}: "):
        compose([*overrides, *NEEDED[source], written(name)])


@pytest.mark.slow
def test_what_is_as_it_would_be_is_no_mistake() -> None:
    """Defaults, also where they are written out, and what an experiment sets for other data."""
    for source, needed in NEEDED.items():
        assert compose(["experiment=published_force", f"data={source}", *needed]).data.source == source
    written_out = ["data.light=standard", "data.pattern=null", "data.images=3000"]
    assert compose(["data=csv", *NEEDED["csv"], *written_out]) == compose(["data=csv", *NEEDED["csv"]])


def test_group_set_whole_is_looked_into() -> None:
    """The setting is the same one, however it is written."""
    with refused(ConfigError, place="data.light"):
        compose(["data=numpy", "data.root=mine.npz", "data={light:dim}"])


def test_arm_is_looked_into(monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm that changes what has no effect is a copy of the search without it."""
    monkeypatch.setattr("tacevo.config.compose.read_arm", lambda choice: arms.parse_arm(choice, "data: {light: dim}"))
    assert compose(["ablation=dim"]).data.light == "dim"
    with refused(ConfigError, place="data.light"):
        compose(["ablation=dim", "data=numpy", "data.root=mine.npz"])


@pytest.mark.slow
def test_study_on_other_data_is_looked_into() -> None:
    """What a study sets must matter to its data, those of the run or others."""
    run = compose(["experiment=demo"])
    assert compose_elsewhere(run, ["data=numpy", "data.root=mine.npz"]).data.root == "mine.npz"
    for overrides in (["data.table=a.csv"], ["data=numpy", "data.root=mine.npz", "data.sensor_seed=3"]):
        with refused(ConfigError, place=overrides[-1].partition("=")[0], expected="no value without"):
            compose_elsewhere(run, overrides)


@pytest.mark.parametrize(
    ("source", "task", "setting", "expected"),
    [
        ("csv", "force", "group_column", True),
        ("csv", "force", "group_pattern", True),
        ("csv", "force", "table", False),
        ("folder", "grating", "group_pattern", True),
        ("folder", "grating", "root", False),
        ("tacverse", "grating", "root", True),
        ("tacverse", "force", "group_pattern", True),
        ("tacverse", "force", "root", False),
        ("numpy", "force", "root", None),
        ("simulated", "grating", "seed", False),
        ("made up", "grating", "seed", None),
    ],
)
def test_settings_say_whether_images_come_in_groups(
    source: str, task: str, setting: str, expected: bool | None
) -> None:
    """By a column, a pattern, or presses that the release names; an archive and a user's source know it themselves."""
    settings = dict.fromkeys(field.name for field in fields(DataConfig)) | {"source": source, setting: OTHER[setting]}
    assert are_grouped(settings, task) is expected
