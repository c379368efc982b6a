"""The gate: from a model's raw answer to an admitted candidate or a typed rejection (parent side, no torch).

What it promises: no code of a candidate runs in this process, not even to be imported; the text that was checked
is the text that is run; equal texts are probed once; nothing that a candidate forges makes a profile that cannot be
described. The static policy is courtesy, the sandbox is the wall.
"""

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass

from tacevo.gate.answers import read
from tacevo.gate.operations import NOT_PORTABLE
from tacevo.gate.policy.check import check
from tacevo.gate.soundness import are_sound_steps, is_sound_graph
from tacevo.profile import Admitted, Profile
from tacevo.records import Completion, Contract, Json, Limits, Reason, Rejection, Stage, to_json
from tacevo.rules import CURRENT, Rules
from tacevo.sandbox.client import Died, Finished
from tacevo.sandbox.protocol import one_line
from tacevo.search.descriptors import describe
from tacevo.storage.store import Store

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


class Gate:
    """Judges candidates of one task.

    Args:
        run: the sandbox; it needs an entry `probe`, `tacevo.gate.probe:run`.
        store: where probes are kept, of kind `probes`.
        answers: where the verdicts of extraction and policy on whole answers are kept, of kind `answers`.
        contract: what a candidate must be.
        limits: how large it may be.
        probe_limits: time and memory of one probe.
        numerics: name of the sandbox's numerics; part of the key, because a probe computes.
        rules: under which verdicts and probes are kept. With others than the current ones, both stores must replay:
            this code gives no verdict of another rule.
    """

    def __init__(
        self,
        *,
        run: RunEntry,
        store: Store,
        answers: Store,
        contract: Contract,
        limits: GateLimits,
        probe_limits: Limits,
        numerics: str,
        rules: Rules,
    ) -> None:
        self._run = run
        self._store = store
        self._answers = answers
        self._contract = contract
        self._limits = limits
        self._probe_limits = probe_limits
        self._numerics = numerics
        self._rules = rules

    def admit(self, completion: Completion) -> Admitted | Rejection:
        """Judge a model's answer.

        Raises:
            SandboxError: the sandbox is broken; nothing was stored.
            CacheMissError: a store only replays and does not know this answer or its source.
        """
        limit, rules = self._limits.source_bytes, self._rules.static
        source = read(completion, self._contract, limit=limit, store=self._answers, rules=rules)
        return source if isinstance(source, Rejection) else self.measure(source)

    def inspect(self, source: str) -> Admitted | Rejection:
        """Judge a text that is source already, such as a task's baseline; raises as `admit` does.

        The policy is computed anew each time, even in a replay: the text is the task's own, and not one that a model
        may have written for another version of Python. Under other rules than the current ones its probe answers for
        it, which was made only because the policy of that time had let it through.
        """
        rejection = check(source, self._contract) if self._rules.static == CURRENT.static else None
        return rejection or self.measure(source)

    def measure(self, source: str) -> Admitted | Rejection:
        """Probe a source that the policy has let through, or recall its probe; raises as `admit` does."""
        answer = self._store.recall(self._request(source), lambda: self._probe(source))
        if "rejection" in answer:
            return Rejection.from_json(answer["rejection"])
        return Admitted(source=source, profile=Profile.from_json(answer["profile"]))

    def _request(self, source: str) -> Json:
        """Name everything that a probe's answer depends on."""
        return {
            "version": self._rules.probe,
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
            return _checked(outcome, self._limits)
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError):
            return _rejected(Reason.crashed, "the probe's answer was no profile and no rejection")


def _checked(outcome: Finished, limits: GateLimits) -> Json:
    """Read the one frame of a probe; nothing in it is trusted, since a candidate can write frames too.

    Raises:
        LookupError, TypeError, ValueError, AttributeError, ArithmeticError: it is not what a probe sends.
    """
    (frame,) = outcome.frames
    if "rejection" in frame.header:
        rejection = Rejection.from_json(frame.header["rejection"])
        if rejection.stage is not Stage.probe or type(rejection.detail) is not str:
            raise ValueError(f"expected a rejection at {Stage.probe} with a text; got one at {rejection.stage}")
        return _rejected(rejection.reason, one_line(rejection.detail))
    profile = Profile.from_json(frame.header["profile"])
    known = profile.not_portable == tuple(sorted(NOT_PORTABLE.keys() & profile.not_portable))
    if not (
        known and _has_allowed_sizes(profile, limits) and is_sound_graph(profile.graph) and are_sound_steps(profile)
    ):
        raise ValueError("expected the profile of a network within the limits")
    if not all(math.isfinite(value) and value >= 0 for value in astuple(describe(profile))):
        raise ValueError("expected a network whose descriptors are finite and >= 0")
    return {"profile": to_json(profile)}


def _has_allowed_sizes(profile: Profile, limits: GateLimits) -> bool:
    """Check the counts against what a probe would have refused."""
    counts = (
        (profile.parameters, limits.parameters),
        (profile.flops, limits.flops),
        (profile.modules, limits.modules),
        (len(profile.graph.nodes), limits.modules),
    )
    return profile.parameters >= 1 and all(type(count) is int and 0 <= count <= limit for count, limit in counts)


def _rejected(reason: Reason, detail: str) -> Json:
    return {"rejection": to_json(Rejection(stage=Stage.probe, reason=reason, detail=detail))}
