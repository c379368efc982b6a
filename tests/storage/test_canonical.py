"""Promise: every setting of a nested configuration is found once, by its whole key."""

from tacevo.storage.canonical import leaves


def test_leaves_bear_their_whole_keys_in_order() -> None:
    """A list is one value."""
    assert list(leaves({"b": {"y": 1, "x": {"z": [2]}}, "a": None})) == [("b.y", 1), ("b.x.z", [2]), ("a", None)]


def test_empty_mapping_is_a_leaf() -> None:
    """Otherwise a key would stand there that nobody has looked at."""
    assert list(leaves({"${HOME}": {}})) == [("${HOME}", {})]
