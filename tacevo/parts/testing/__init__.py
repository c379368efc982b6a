"""The kit: what each kind of part promises, as tests that anybody's pytest, or `tacevo parts check`, can run.

    import pytest
    from tacevo.parts.testing import contracts

    @pytest.mark.parametrize("contract", contracts(Lexicase()), ids=str)
    def test_lexicase_keeps_its_contracts(contract):
        contract.check()

`check(Lexicase())` does the same in one call. A part is imported and called in the process of the test, so check only
parts whose code you trust.
"""

import os
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import tacevo.parts.protocols
from tacevo.parts.kinds import COMMANDS, EXECUTORS, KINDS, OUTPUTS, PROVIDERS, SOURCES, TRACKERS, Kind
from tacevo.parts.output import Output
from tacevo.parts.testing.contract import Contract, check_frozen
from tacevo.parts.testing.deciding import deciding_contracts
from tacevo.parts.testing.executor import executor_contracts
from tacevo.parts.testing.others import command_contracts, output_contracts, provider_contracts, tracker_contracts
from tacevo.parts.testing.source import source_contracts

__all__ = ["Contract", "check", "contracts", "kind_of"]

#: The methods by which a part without a base class is known.
_METHODS: Mapping[Kind, tuple[str, ...]] = {
    SOURCES: ("describe", "catalogue"),
    PROVIDERS: ("complete",),
    EXECUTORS: ("check", "ahead", "open"),
    TRACKERS: ("mirror", "viewing"),
}

_CONTRACTS: Mapping[Kind, Callable[[Any], list[Contract]]] = {
    SOURCES: source_contracts,
    PROVIDERS: provider_contracts,
    EXECUTORS: executor_contracts,
    TRACKERS: tracker_contracts,
    COMMANDS: command_contracts,
}


def kind_of(part: object) -> Kind | None:
    """Return the kind of a part or of its class: by the class that it extends, or by its methods; None of no part."""
    made = part if isinstance(part, type) else type(part)
    for kind in KINDS.values():
        if kind.base and issubclass(made, getattr(tacevo.parts.protocols, kind.base)):
            return kind
    if issubclass(made, Output):
        return OUTPUTS
    for kind, methods in _METHODS.items():
        if all(callable(getattr(made, name, None)) for name in methods):
            return kind
    return COMMANDS if callable(part) and not isinstance(part, type) else None


def contracts(part: Any, *, run: str | os.PathLike[str] | None = None) -> list[Contract]:
    """List what a part promises, by its kind; nothing is called yet.

    Args:
        part: made with its settings, e.g. `Lexicase(cases="fitness,novelty")`; of a command, the function.
        run: of an output, a finished run or sweep that it is tried with: its directory or its bundle.

    Raises:
        TypeError: it is none of the kinds.
    """
    kind = kind_of(part)
    if kind is None:
        expected = "a part made with its settings: it extends a class of tacevo.parts, or has the methods of a protocol"
        raise TypeError(f"expected {expected}; got {part!r}")
    if kind.decides:
        return deciding_contracts(part, kind)
    if kind in _METHODS:
        return [Contract("is a frozen dataclass", partial(check_frozen, part)), *_CONTRACTS[kind](part)]
    return output_contracts(part, run) if kind is OUTPUTS else _CONTRACTS[kind](part)


def check(part: Any, *, run: str | os.PathLike[str] | None = None) -> None:
    """Test all that a part promises.

    Args:
        part: as of `contracts`.
        run: as of `contracts`.

    Raises:
        AssertionError: it breaks a promise; the message has a line for each that it breaks.
        TypeError: it is none of the kinds.
    """
    broken = [f"{contract}: {fault}" for contract in contracts(part, run=run) if (fault := contract.fault())]
    if broken:
        raise AssertionError("\n".join(["broken promises of a part:", *broken]))
