"""Promise: a key that stands twice in a YAML file of a user is told, and never the last one taken."""

from pathlib import Path

import pytest
import yaml
from refusals import refused

from tacevo.config import task_texts
from tacevo.config.arms import parse_arm
from tacevo.config.strict_yaml import read_yaml
from tacevo.errors import ConfigError
from tacevo.runs.providers import load_prices
from tacevo.sweeps.launch import split_launcher


@pytest.mark.parametrize(
    "text",
    [
        "a: 1\na: 2\n",
        "a: 1\nb: {x: 1, x: 1}\n",
        "- {0x10: a, 16: b}\n",
        "'a': 1\n\"a\": 1\n",
        "<<: {a: 1}\n<<: {b: 1}\n",
        "? [a, b]\n: 1\n",
    ],
)
def test_key_that_comes_twice_is_refused(text: str) -> None:
    """At any depth, in any spelling; a list is no key at all."""
    with pytest.raises(yaml.YAMLError):
        read_yaml(text)


@pytest.mark.parametrize(
    ("text", "content"),
    [
        ("b: &b {x: 1, y: 1}\nc: {<<: *b, x: 2}\n", {"b": {"x": 1, "y": 1}, "c": {"x": 2, "y": 1}}),
        ("b: &b {x: 1}\nc: &c {y: 2}\nd: {<<: [*b, *c]}\n", {"b": {"x": 1}, "c": {"y": 2}, "d": {"x": 1, "y": 2}}),
        (
            "b: &b {x: 1}\nt: {c: &c {<<: *b, x: 2}}\nd: {<<: *c}\n",
            {"b": {"x": 1}, "t": {"c": {"x": 2}}, "d": {"x": 2}},
        ),
    ],
)
def test_merged_keys_are_not_keys_that_come_twice(text: str, content: object) -> None:
    """A mapping may take the keys of others, and replace some, also where another one takes its keys in turn."""
    assert read_yaml(text) == content


def test_only_text_is_as_it_is_written() -> None:
    """Then 0x10 and 16 are two keys."""
    assert read_yaml("{0x10: 1.0, 16: yes}", only_text=True) == {"0x10": "1.0", "16": "yes"}
    with pytest.raises(yaml.YAMLError, match="'a' a second time"):
        read_yaml("{a: x, a: x}", only_text=True)


def test_every_reader_of_yaml_refuses_it(tmp_path: Path) -> None:
    """Arms, prices, instructions, and options of the launcher."""
    twice = tmp_path / "twice.yaml"
    twice.write_text("{a: 1, a: 2}")
    with refused(ConfigError, place="conf/ablation/mine.yaml", expected="YAML", got="'a' a second time"):
        parse_arm("mine", twice.read_text())
    with refused(ConfigError, place="llm.prices", expected="YAML", got="'a' a second time"):
        load_prices(str(twice))
    with refused(ConfigError, place="task.instructions", got="'a' a second time"):
        task_texts._read_library(str(twice))
    with refused(ConfigError, place="hydra.launcher"):
        split_launcher(["hydra.launcher.params={a: 1, a: 2}"])
