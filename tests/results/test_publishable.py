"""Promise: published settings name no directory of a machine, and overrides give what the configuration says."""

from pathlib import Path

import pytest
from refusals import refused

from tacevo.config.compose import compose
from tacevo.config.plain import from_plain
from tacevo.errors import ConfigError
from tacevo.records import to_json
from tacevo.results.publishable import published_config, published_overrides
from tacevo.storage.canonical import value_at

#: Settings that are paths, in every form; those of a release after those of a table.
OF_TABLE = ["data=csv", "data.target_columns=[fx]", "data.table=/home/secret/labels.csv"]
OF_RELEASE = ["data=tacverse", "task=grating", "data.sensor=/home/secret/gelsight", "data.pattern=/home/secret/pattern"]
OF_BOTH = [
    "data.root=/home/secret/images",
    "llm.prices=/home/secret/prices.yaml",
    "task.baseline=/home/secret/baseline.py",
    "task.instructions=/home/secret/instructions.yaml",
    "task.system=/home/secret/system.txt",
    "store.root=/home/secret/cache",
    "run.dir=/home/secret/run",
    "tracking.uri=http://secret:5000",
    "llm.base_url=http://secret/v1",
]


@pytest.mark.parametrize(
    ("paths", "left"),
    [(OF_TABLE, {"table": "labels.csv"}), (OF_RELEASE, {"sensor": "gelsight", "pattern": "pattern"})],
    ids=["table", "release"],
)
def test_no_path_and_no_address_is_left(paths: list[str], left: dict[str, str]) -> None:
    """Each keeps its last part, or goes."""
    published = published_config(to_json(compose([*paths, *OF_BOTH])))
    assert "secret" not in str(published)
    for name, value in {"root": "images", **left}.items():
        assert value_at(published, ("data", name)) == value


@pytest.mark.parametrize("root", [".", "..", "/", "images/.."])
def test_folder_without_a_name_gets_one(root: str) -> None:
    """An empty name would make the published configuration none that can be read."""
    published = published_config(to_json(compose(["data=folder", f"data.root={root}"])))
    assert value_at(published, ("data", "root")) == "data"
    assert from_plain(published).data.root == "data"


def test_relative_files_stay() -> None:
    """They say nothing of the machine, and which file it was."""
    config = to_json(compose(["data=csv", "data.root=x", "data.target_columns=[fx]", "data.table=tables/labels.csv"]))
    assert value_at(published_config(config), ("data", "table")) == "tables/labels.csv"
    assert published_config(config)["task"] == config["task"]


@pytest.mark.parametrize("paths", [OF_TABLE, OF_RELEASE], ids=["table", "release"])
def test_overrides_give_the_published_configuration(paths: list[str]) -> None:
    """What is left of the command composes to what is left of the settings."""
    command = [*paths, *OF_BOTH, "seed=4"]
    published = published_config(to_json(compose(command)))
    composed = to_json(compose(published_overrides(command)))
    assert "secret" not in str(published_overrides(command))
    for group in ("seed", "data", "task", "search", "archive"):
        assert composed[group] == published[group]


def test_quoted_override_stays_quoted() -> None:
    """A name with a space is still one value."""
    assert published_overrides(["data.root='/home/a b/c d'", "data.pattern=null"]) == (
        "data.root='c d'",
        "data.pattern=null",
    )


def test_original_is_left_as_it_is() -> None:
    """Publishing changes nothing of the run."""
    config = to_json(compose([*OF_TABLE, *OF_BOTH]))
    before = str(config)
    published_config(config)
    assert str(config) == before


@pytest.mark.parametrize("override", ["store={root:/home/secret}", "data={root:/home/secret}", "run= {dir:x}"])
def test_group_set_whole_is_refused(override: str) -> None:
    """A path in it would be published."""
    group = override.partition("=")[0]
    with refused(ConfigError, expected="one override per setting", got=override, remedy=f"{group}.NAME=VALUE"):
        published_overrides(["seed=0", override])


def test_label_stands_for_a_model_that_is_a_path() -> None:
    """In the configuration; an arm's name has the last part, as of every path."""
    chosen = ["llm=openai", "llm.model=/home/secret/llama"]
    labelled = published_config(to_json(compose([*chosen, "llm.label=llama-8b"])))
    assert value_at(labelled, ("llm", "model")) == "llama-8b"
    assert from_plain(labelled).llm.name == "llama-8b"
    assert published_overrides(chosen) == ("llm=openai", "llm.model=llama")
    assert published_overrides(["llm.model=meta/llama"]) == ("llm.model=meta/llama",)


def test_given_networks_keep_their_last_parts(tmp_path: Path) -> None:
    """Each of a list, in the settings and in the overrides of a sweep."""
    for name in ("one.py", "other.py"):
        (tmp_path / "secret" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "secret" / name).write_text("class Net: pass\n")
    override = f"search.networks=[{tmp_path}/secret/one.py,{tmp_path}/secret/other*]"
    config = to_json(compose(["experiment=demo", override]))
    assert value_at(published_config(config), ("search", "networks")) == ["one.py", "other*"]
    assert published_overrides([override]) == ("search.networks=[one.py,other*]",)
