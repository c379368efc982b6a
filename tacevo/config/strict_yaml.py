"""YAML in which no mapping has a key twice; PyYAML would take the last of them without a word."""

from collections.abc import Hashable
from typing import Any

import yaml

#: The tag of the key `<<`, whose mapping gives the keys that the mapping itself lacks.
_MERGE = "tag:yaml.org,2002:merge"


class _Once:
    """Refuses a mapping that has a key twice; a loader beside it does the rest."""

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Read a mapping whose keys are all different, before those that `<<` merges into it join them."""
        node: yaml.MappingNode = super().compose_mapping_node(anchor)  # type: ignore[misc]
        seen = set()
        for key_node, _ in node.value:
            is_merge = key_node.tag == _MERGE
            key = _MERGE if is_merge else self.construct_object(key_node, deep=True)  # type: ignore[attr-defined]
            if isinstance(key, Hashable):  # the loader refuses other keys
                if key in seen:
                    raise yaml.constructor.ConstructorError(None, None, f"{key!r} a second time", key_node.start_mark)
                seen.add(key)
        return node


class _Values(_Once, yaml.SafeLoader):
    """Reads scalars as YAML means them."""


class _Texts(_Once, yaml.BaseLoader):
    """Reads every scalar as text."""


def read_yaml(text: str, *, only_text: bool = False) -> Any:
    """Return what a YAML text holds; with `only_text`, every scalar as it is written.

    Raises:
        yaml.YAMLError: it is not YAML, or a mapping has a key twice.
    """
    return yaml.load(text, _Texts if only_text else _Values)
