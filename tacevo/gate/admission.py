"""The gate: from a model's raw answer to an admitted candidate or a typed rejection (parent side, no torch).

What it promises: no code of a candidate runs in this process, not even to be imported; the text that was checked
is the text that is run; equal texts are probed once. The static policy is courtesy, the sandbox is the wall.
"""

from collections.abc import Callable
from dataclasses import dataclass

from tacevo.gate.extraction import extract
from tacevo.gate.policy import check
from tacevo.records import Completion, Contract, Graph, Json, Limits, Profile, Reason, Rejection, Stage, to_json
from tacevo.sandbox.client import Died, Finished
from tacevo.store import Store

#: Raised when the probe or the tracer changes what it answers; part of every probe's key.
PROBE_VERSION = 1

#: Runs a sandbox entry: name, header, payload, limits.
RunEntry = Callable[[str, Json, bytes, Limits], Finished | Died]


@dataclass(frozen=True, slots=True, kw_only=True)
class GateLimits:
    """How large a candidate may be; each limit is inclusive."""

    parameters: int
    #: Floating-point operations of one forward pass of one image.
    flops: int
    #: Modules of the network, and operations of one forward pass.
    modules: int
    #: UTF-8 bytes of a model's whole answer.
    source_bytes: int = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Admitted:
    """A candidate that may be trained."""

    source: str
    profile: Profile


class Gate:
    """Judges candidates of one task.

    Args:
        run: the sandbox; it needs an entry `probe`, `tacevo.gate.probe:run`.
        store: where probes are kept, of kind `probes`.
        contract: what a candidate must be.
        limits: how large it may be.
        probe_limits: time and memory of one probe.
        numerics: name of the sandbox's numerics; part of the key, because a probe computes.
    """

    def __init__(
        self,
        *,
        run: RunEntry,
        store: Store,
        contract: Contract,
        limits: GateLimits,
        probe_limits: Limits,
        numerics: str,
    ) -> None:
        self._run = run
        self._store = store
        self._contract = contract
        self._limits = limits
        self._probe_limits = probe_limits
        self._numerics = numerics

    def admit(self, completion: Completion) -> Admitted | Rejection:
        """Judge a model's answer.

        Raises:
            SandboxError: the sandbox is broken; nothing was stored.
            CacheMissError: the store only replays and does not know this source.
        """
        source = extract(completion, self._contract, limit=self._limits.source_bytes)
        return source if isinstance(source, Rejection) else self.inspect(source)

    def inspect(self, source: str) -> Admitted | Rejection:
        """Judge a text that is source already, such as a task's baseline; raises as `admit` does."""
        rejection = check(source, self._contract)
        if rejection is not None:
            return rejection
        answer = self._store.recall(self._request(source), lambda: self._probe(source))
        if "rejection" in answer:
            return Rejection.from_json(answer["rejection"])
        return Admitted(source=source, profile=Profile.from_json(answer["profile"]))

    def _request(self, source: str) -> Json:
        """Name everything that a probe's answer depends on."""
        return {
            "version": PROBE_VERSION,
            "source": source,
            "contract": to_json(self._contract),
            "limits": self._sizes(),
            "probe_limits": to_json(self._probe_limits),
            "numerics": self._numerics,
        }

    def _sizes(self) -> Json:
        return {
            "parameters": self._limits.parameters,
            "flops": self._limits.flops,
            "modules": self._limits.modules,
        }

    def _probe(self, source: str) -> Json:
        """Run the probe in the sandbox; give its answer as the store keeps it."""
        header = {"source": source, "contract": to_json(self._contract), "limits": self._sizes()}
        outcome = self._run("probe", header, b"", self._probe_limits)
        if isinstance(outcome, Died):
            return _rejected(outcome.reason, outcome.detail)
        try:
            return _checked(outcome)
        except (LookupError, TypeError, ValueError, AttributeError):
            return _rejected(Reason.crashed, "the probe's answer was no profile and no rejection")


def _checked(outcome: Finished) -> Json:
    """Read the one frame of a probe; nothing in it is trusted, since a candidate can write frames too.

    Raises:
        LookupError, TypeError, ValueError, AttributeError: it is not what a probe sends.
    """
    (frame,) = outcome.frames
    if "rejection" in frame.header:
        rejection = Rejection.from_json(frame.header["rejection"])
        if rejection.stage is not Stage.probe:
            raise ValueError(f"expected a rejection at {Stage.probe}; got one at {rejection.stage}")
        return _rejected(rejection.reason, str(rejection.detail)[:300])
    profile = Profile.from_json(frame.header["profile"])
    sizes = (profile.parameters, profile.flops, profile.modules, *(node.width for node in profile.graph.nodes))
    if not all(type(size) is int and size >= 0 for size in sizes) or not _is_acyclic(profile.graph):
        raise ValueError("expected sizes >= 0 and edges from earlier to later nodes")
    return {"profile": to_json(profile)}


def _is_acyclic(graph: Graph) -> bool:
    """Check that every edge leads from a node to a later one."""
    return all(0 <= producer < consumer < len(graph.nodes) for producer, consumer in graph.edges)


def _rejected(reason: Reason, detail: str) -> Json:
    return {"rejection": to_json(Rejection(stage=Stage.probe, reason=reason, detail=detail))}
