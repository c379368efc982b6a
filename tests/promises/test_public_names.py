"""Promise: the public names of Python and of parts keep their signatures from one release to the next."""

import inspect
from collections.abc import Iterator

import pytest
from syrupy.assertion import SnapshotAssertion

import tacevo
import tacevo.parts
from tacevo.parts import executor, output, provider, source, tracker

#: What a user may import, by the module that it is imported from; of a protocol's module all that is defined there.
MODULES = (tacevo, tacevo.parts, source, provider, executor, tracker, output)


def members(module: object) -> Iterator[tuple[str, object]]:
    """Yield the public names of a module, and of each class its own public names, as a user writes them."""
    name = module.__name__  # type: ignore[attr-defined]  # each is a module
    names = getattr(module, "__all__", None) or [
        key for key, value in vars(module).items() if getattr(value, "__module__", "") == name and key[0] != "_"
    ]
    for key in sorted(names):
        value = getattr(module, key)
        yield f"{name}.{key}", value
        if inspect.isclass(value) and not issubclass(value, Exception):
            own = {each: inspect.getattr_static(value, each) for each in dir(value) if each[0] != "_"}
            yield from ((f"{name}.{key}.{each}", part) for each, part in sorted(own.items()))


def written(name: str, value: object) -> str:
    """Write a name with its signature; an attribute has none, nor a class whose objects users are given."""
    part = value.__func__ if isinstance(value, classmethod | staticmethod) else value
    if not callable(part) or inspect.isclass(part):
        return name
    try:
        return f"{name}{inspect.signature(part)}"
    except ValueError:  # built in
        return name


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_public_names_have_their_signatures(module: object, recorded_text: SnapshotAssertion) -> None:
    """A name that goes, or takes other arguments, breaks the programs of users: it changes with a new first number."""
    assert "\n".join(written(*each) for each in members(module)) + "\n" == recorded_text
