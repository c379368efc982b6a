"""Nested settings by their whole keys; pure."""

from collections.abc import Iterator, Mapping

from tacevo.records import Json


def leaves(nested: Mapping[str, Json], prefix: str = "") -> Iterator[tuple[str, Json]]:
    """Walk nested settings in their order: `{"llm": {"model": "m"}}` gives `("llm.model", "m")`.

    What holds no settings is a leaf: a list, and an empty mapping too.
    """
    for name, value in nested.items():
        if isinstance(value, Mapping) and value:
            yield from leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
