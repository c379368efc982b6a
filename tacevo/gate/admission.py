"""The gate: from a model's raw answer to an admitted candidate or a typed rejection (parent side, no torch).

What it promises: this process does not run or import a candidate's code; the text that was checked is the text that
runs; equal texts are probed once; every profile has finite descriptors, even a forged one. The static policy is
courtesy, the sandbox is the wall.
"""

import contextlib
import hashlib
import re
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from tacevo.choices import Numerics
from tacevo.gate.extraction import edited, extract, extracted, first_look
from tacevo.gate.operations import NOT_PORTABLE
from tacevo.gate.policy.check import rejection_of
from tacevo.profile import Admitted, Profile
from tacevo.records import Completion, Contract, Json, Limits, Reason, Rejection, Stage, to_json
from tacevo.rules import CURRENT, Rules
from tacevo.sandbox.client import AnswerError, Died, RunJob
from tacevo.sandbox.protocol import one_line
from tacevo.storage.store import Store
from tacevo.storage.verdicts import read_verdict, recall_verdict

#: The first number of static rules by which a given network that is repeated before other code is no answer, and the
#: first by which a verdict's key holds what was asked.
_GIVEN_SINCE, _ASKED_SINCE = 3, 4
#: The first number of probes that show a network images of the data set.
_SHOWN_SINCE = 7
#: The number of these images: as many as the probe's largest batch has (`_MOST` of `tacevo.gate.probe`).
_PROBED = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class GateLimits:
    """The limits of a candidate's size; each is inclusive."""

    parameters: int
    #: Floating-point operations of one forward pass of one image.
    flops: int
    #: Modules of the network, and operations of one forward pass.
    modules: int


@dataclass(frozen=True, slots=True, kw_only=True)
class DataImages:
    """The images of a data set on which networks are probed, too: rows of the array `images` of the sandbox."""

    rows: NDArray[np.int64]
    #: The mean of each channel, in units of the stored values (0 to 255); deviations are positive.
    mean: tuple[float, ...]
    deviation: tuple[float, ...]

    @classmethod
    def of(cls, rows: NDArray[np.int64], mean: tuple[float, ...], deviation: tuple[float, ...]) -> Self:
        """Choose evenly among some rows, as many as a probe takes; of fewer, some stand twice."""
        indices = np.linspace(0, len(rows) - 1, _PROBED).astype(np.int64)
        return cls(rows=rows[indices], mean=mean, deviation=deviation)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate:
    """Judges candidates of one task."""

    #: The sandbox; it needs an entry `probe`, `tacevo.gate.probe:run`.
    run: RunJob
    #: The store of probes, of kind `probes`.
    store: Store
    #: The store of the verdicts of extraction and policy on whole answers, of kind `answers`.
    answers: Store
    contract: Contract
    limits: GateLimits
    #: The fingerprint of the data set on whose images networks are probed, too; None where there is none.
    fingerprint: str | None = None
    #: The images for probes; None where there is no data set, and where probes are recalled only or looked up.
    images: DataImages | None = None
    #: UTF-8 bytes of a model's whole answer.
    source_bytes: int = 100_000
    #: Time and memory of one probe.
    probe_limits: Limits
    #: The numerics of the sandbox; part of the key, because a probe computes.
    numerics: Numerics
    #: The rules under which verdicts and probes are kept. With other rules than the current ones, both stores must
    #: replay, because this code judges by the current rules only.
    rules: Rules

    def admit(self, completion: Completion, asked: str = "") -> Admitted | Rejection:
        """Judge a model's answer.

        Args:
            completion: the answer.
            asked: what the model was asked, with the networks that it was given; empty where that is not known.

        Raises:
            SandboxError: the sandbox is broken; nothing was stored.
            CacheMissError: a store only replays and does not know this answer or its source.
        """
        rejection = first_look(completion, limit=self.source_bytes)
        if rejection is not None:  # not stored: such an answer may be huge, or text that no file can hold
            return rejection
        request: dict[str, Json] = {
            "version": self.rules.static,
            "text": completion.text,
            "stop_reason": completion.stop_reason,
            "contract": to_json(self.contract),
            "limit": self.source_bytes,
        }
        if asked and self.rules.static >= _ASKED_SINCE:  # the hash, not the networks in it: those take a parser
            request["asked"] = hashlib.sha256(asked.encode(errors="replace")).hexdigest()
        # Python 3.12 parses text that 3.11 does not: a replay that judged again could differ from its recording.
        source = recall_verdict(self.answers, request, str, "source", lambda: self._extract(completion, asked))
        if isinstance(source, str) and self._was_given(source, asked):
            again: dict[str, Json] = {**request, "own": False}
            source = recall_verdict(self.answers, again, str, "source", lambda: self._extract(completion, asked))
        return source if isinstance(source, Rejection) else self.measure(source)

    def edited(self, completion: Completion, parent: str) -> Completion | Rejection:
        """Return an answer that is a parent after the edits that an answer has; the answer itself where it has none.

        What comes is for `admit`, which judges it as any other answer. Nothing is stored: it takes no parser.

        Args:
            completion: the answer.
            parent: the network that it may be edits of, as the model was given it.
        """
        return first_look(completion, limit=self.source_bytes) or edited(completion, parent, self.contract.class_name)

    def notes(self, completion: Completion, asked: str = "") -> tuple[str, ...]:
        """Say what of an answer was changed, so that the policy could let it pass; empty where nothing was.

        It reads the answer again, by the current rules: no verdict depends on it.
        """
        if first_look(completion, limit=self.source_bytes) is not None:
            return ()
        found = extracted(completion, self.contract, asked)
        return () if isinstance(found, Rejection) else found.notes

    def _was_given(self, source: str, asked: str) -> bool:
        """Return whether the rules have a verdict of its own on an answer whose source was given, which is replayed."""
        return _GIVEN_SINCE <= self.rules.static < _ASKED_SINCE and _squeezed(source) in _squeezed(asked)

    def inspect(self, source: str) -> Admitted | Rejection:
        """Judge a text that is source already, and that no model wrote: a task's baseline; raises as `admit` does.

        The policy is checked each time, even in a replay: the text is the task's own, and not one that a model may have
        written for another version of Python. Under other rules than the current ones it is not checked, because the
        recorded probe was made only after the policy of that time had admitted the text.
        """
        rejection = rejection_of(source, self.contract) if self.rules.static == CURRENT.static else None
        return rejection or self.measure(source)

    def measure(self, source: str) -> Admitted | Rejection:
        """Probe a source that the policy has admitted, or recall its probe; raises as `admit` does.

        It does not parse the source, so it answers alike under every version of Python.
        """
        request = self._probe_request(source)
        verdict = recall_verdict(self.store, request, Profile, "profile", lambda: self._probe(source))
        return verdict if isinstance(verdict, Rejection) else Admitted(source=source, profile=verdict)

    def is_measured(self, source: str) -> bool:
        """Return whether the store has a probe of a source, sound or not."""
        return self.store.holds(self.store.key(self._probe_request(source)))

    def _probe_request(self, source: str) -> dict[str, Json]:
        request: dict[str, Json] = {
            "version": self.rules.probe,
            **self._asked(source),
            "probe_limits": to_json(self.probe_limits),
            "numerics": self.numerics.value,
        }
        if self.fingerprint is not None and self.rules.probe >= _SHOWN_SINCE:
            request["data"] = self.fingerprint
        return request

    def _extract(self, completion: Completion, asked: str) -> str | Rejection:
        source = extract(completion, self.contract, asked)
        return source if isinstance(source, Rejection) else rejection_of(source, self.contract) or source

    def _asked(self, source: str) -> dict[str, Json]:
        """Return the header of a probe's job."""
        return {"source": source, "contract": to_json(self.contract), "limits": to_json(self.limits)}

    def _probe(self, source: str) -> Profile | Rejection:
        """Run the probe in the sandbox and check its answer, of which nothing is trusted."""
        header, payload = self._asked(source), b""
        if self.images is not None:
            header |= {"mean": list(self.images.mean), "deviation": list(self.images.deviation)}
            payload = self.images.rows.tobytes()
        outcome = self.run("probe", header, payload, self.probe_limits)
        if isinstance(outcome, Died):
            return _rejected(outcome.reason, outcome.detail)
        headers = [frame.header for frame in outcome.frames]
        with contextlib.suppress(AnswerError):
            match [read_verdict(Profile, "profile", header, place="", error=AnswerError) for header in headers]:
                case [Profile() as profile] if _is_of_a_probe(profile, self.limits):
                    return profile
                case [Rejection(stage=Stage.probe, reason=reason, detail=detail)]:
                    return _rejected(reason, one_line(detail))
        return _rejected(Reason.crashed, "expected a profile or a rejection from the probe; got neither")


def _squeezed(text: str) -> str:
    """Return a text without comments and spaces, which a model does not repeat."""
    return re.sub(r"#.*|\s+", "", text)


def _is_of_a_probe(profile: Profile, limits: GateLimits) -> bool:
    """Return whether a network is no larger than the probe lets it be, and its kernels are some that it looks for."""
    return (
        profile.learnt <= limits.parameters
        and profile.training_flops <= limits.flops
        and max(profile.modules, len(profile.graph.nodes)) <= limits.modules
        and profile.not_portable == tuple(sorted(NOT_PORTABLE.keys() & profile.not_portable))
    )


def _rejected(reason: Reason, detail: str) -> Rejection:
    return Rejection(stage=Stage.probe, reason=reason, detail=detail)
