"""What a node must have in common with the search, and what differs."""

import functools
import hashlib
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from tacevo.choices import Confinement, Device, Numerics
from tacevo.environment import machine, versions
from tacevo.errors import SandboxError, TacevoError
from tacevo.redaction import secret_variables
from tacevo.rules import CURRENT, STUDY
from tacevo.sandbox.confinement import available, check_confinement
from tacevo.sandbox.devices import DEVICES
from tacevo.training.numerics import check_machine, environment

#: Packages whose code makes a profile or a training.
_DECISIVE = ("tacevo", "torch", "numpy")

#: The variable by which the processes of a Ray cluster know each other.
TOKEN = "RAY_AUTH_TOKEN"

#: Named as secrets are, but a node may hold them; GPG_KEY in the official images of Python is a public key's.
_HARMLESS = frozenset({TOKEN, "GPG_KEY"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """What a run demands of each node; it goes to all of them, and holds no key."""

    #: Of the sandbox.
    entries: Mapping[str, str]
    equip: str | None
    numerics: Numerics
    device: Device
    #: The model of the GPU; None for any, or on a CPU.
    gpu: str | None
    #: Most trainings on one GPU at once; None for as many as fit, on this machine.
    per_gpu: int | None
    #: The weakest confinement that will do.
    require: Confinement

    @property
    def environment(self) -> dict[str, str]:
        """The variables of a candidate's process that decide its results."""
        return environment(self.numerics, self.device)

    @property
    def strongest(self) -> Confinement:
        """The strongest confinement of a candidate on this device: on a GPU all of it or none, as is demanded."""
        is_walled = self.device is Device.cpu or self.require is Confinement.kernel
        return Confinement.kernel if is_walled else Confinement.none

    @property
    def doors(self) -> tuple[str, ...]:
        """Patterns of the device files that the walls leave open to what computes on a GPU."""
        return () if self.device is Device.cpu or self.require is not Confinement.kernel else DEVICES


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """What decides the results of a node, by name, and how it would confine a candidate."""

    decisive: Mapping[str, str]
    level: Confinement
    #: Why it cannot do what is ordered; None where it can.
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
