"""The facts that a node must have in common with the search, and those that differ."""

import functools
import hashlib
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from tacevo.choices import Confinement, Numerics
from tacevo.environment import machine, versions
from tacevo.errors import SandboxError, TacevoError
from tacevo.parts.executor import Order
from tacevo.redaction import secret_variables
from tacevo.rules import CURRENT, STUDY
from tacevo.sandbox.confinement import available, check_confinement
from tacevo.training.numerics import check_machine

#: Packages whose code makes a profile or a training.
_DECISIVE = ("tacevo", "torch", "numpy")

#: The variable by which the processes of a Ray cluster know each other.
TOKEN = "RAY_AUTH_TOKEN"

#: Named as secrets are, but a node may hold them; GPG_KEY in the official images of Python is a public key's.
_HARMLESS = frozenset({TOKEN, "GPG_KEY"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """The facts that decide the results of a node, by name, and the way in which it would confine a candidate."""

    decisive: Mapping[str, str]
    level: Confinement
    #: The error that says why the node cannot do what is ordered; None where it can.
    fault: TacevoError | None = None


def facts_here(order: Order) -> Facts:
    """Find out what this process would compute with."""
    installed = versions()
    decisive = {
        "python": ".".join(platform.python_version_tuple()[:2]),
        **{package: installed[package] for package in _DECISIVE},
        **{f"rules of {part}": str(number) for part, number in asdict(CURRENT).items()},
        "rules of study": str(STUDY),
        "code": _code(),
        **({"cpu": str(machine()["cpu"])} if order.numerics is Numerics.fast else {}),
        **order.environment,
    }
    level = min(available(), order.strongest, key=list(Confinement).index)
    return Facts(decisive=decisive, level=level, fault=_fault(order))


def keys_here() -> tuple[str, ...]:
    """List the variables of this process that hold a key, but for those that a node needs."""
    return tuple(name for name in secret_variables(os.environ) if name not in _HARMLESS)


def check_alike(facts: Facts, wanted: Facts, place: str) -> None:
    """Check that a node computes what the search would compute itself, and can do what is ordered.

    Raises:
        SandboxError: it cannot, or something differs; the place is the node.
    """
    if facts.fault is not None:
        fault = facts.fault
        raise SandboxError(fault.got, place=f"{place}, {fault.place}", expected=fault.expected, remedy=fault.remedy)
    names = sorted(facts.decisive.keys() | wanted.decisive.keys())
    differing = [name for name in names if facts.decisive.get(name) != wanted.decisive.get(name)]
    if differing:
        raise SandboxError(
            _listed(differing, facts.decisive),
            place=place,
            expected=_listed(differing, wanted.decisive),
            remedy="install there what is installed here, or take the node out of the cluster",
        )


def _listed(names: list[str], values: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {values.get(name, 'absent')}" for name in names)


@functools.cache
def _code() -> str:
    """Return 12 hex digits that stand for the code of this package: two checkouts of one version may differ."""
    root = Path(__file__).parents[1]
    sources = {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*.py")}
    digests = {name: hashlib.sha256(source).hexdigest() for name, source in sources.items()}
    return hashlib.sha256(repr(sorted(digests.items())).encode()).hexdigest()[:12]


def _fault(order: Order) -> TacevoError | None:
    """Return why this process cannot do what is ordered; None where it can."""
    held = keys_here()
    if held:
        return SandboxError(
            f"{', '.join(held)} in the environment of Ray",
            place="environment",
            expected="no key or password where candidates run",
            remedy="unset it before `ray start`",
        )
    try:
        check_confinement(order.require)
        check_machine(order.numerics, order.device, order.gpu)
    except TacevoError as error:
        return error
    return None
