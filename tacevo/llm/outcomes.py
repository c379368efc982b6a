"""What a run learns of its models, and what becomes of the requests that got no answer; for every provider."""

from collections.abc import Set
from dataclasses import dataclass, field, replace

from tacevo.errors import ConfigError, LLMError, TransportError
from tacevo.llm.faults import Fault, FaultError, FaultKind, setting_to_drop
from tacevo.records import Completion, Delivery, Request


class Models:
    """Remembers, for a run, which sampling settings a model refuses, and which models answer at all."""

    def __init__(self) -> None:
        self._dropped: dict[str, tuple[str, ...]] = {}
        self._answering: set[str] = set()

    def dropped(self, request: Request) -> tuple[str, ...]:
        """Name the sampling settings that are not to be sent to a request's model, sorted."""
        return self._dropped.get(request.model, ())

    def learn(self, request: Request, sent: Set[str], fault: Fault) -> bool:
        """Learn from a refusal; say whether the request is worth another try without a setting.

        Args:
            request: what was refused.
            sent: names of the settings that it was sent with.
            fault: the refusal.
        """
        name = setting_to_drop(fault, sent)
        if name is not None:
            self._dropped[request.model] = tuple(sorted({*self.dropped(request), name}))
        return name is not None

    def note_answer(self, request: Request) -> None:
        """Note that a model answers: what it refuses from now on is about the request."""
        self._answering.add(request.model)

    def answers(self, request: Request) -> bool:
        """Say whether a request's model ever answered in this run."""
        return request.model in self._answering


@dataclass(slots=True, kw_only=True)
class Failures:
    """The requests of one round that got no answer, as (position, request, fault)."""

    #: What the user chose, for messages, e.g. `llm=anthropic`.
    name: str
    models: Models
    delivery: Delivery = Delivery.direct
    #: Whether nothing further should begin: the key is refused, or the server failed after all tries.
    hopeless: bool = False
    _all: list[tuple[int, Request, Fault]] = field(default_factory=list)

    def add(self, position: int, request: Request, fault: Fault) -> None:
        """Note a failure."""
        self._all.append((position, request, fault))
        self.hopeless = self.hopeless or fault.kind in {FaultKind.refused, FaultKind.passing}

    def recorded(self) -> list[tuple[int, Completion]]:
        """Give completions in place of the requests that can never be answered, so that they stop no run.

        A doubtful refusal is about its request where the model answered another one; else it is about the settings.
        """
        return [
            (position, self._in_place(request, fault))
            for position, request, fault in self._all
            if self._is_about_the_request(request, fault)
        ]

    def raise_rest(self, requests: int, *, interrupted: bool) -> None:
        """Raise what remains of the failures.

        Args:
            requests: how many the round held, for the message.
            interrupted: whether requests were left out because somebody stopped the run.

        Raises:
            ConfigError: the key, the model, a setting or the payment is refused; asking again cannot help.
            TransportError: requests failed after all tries.
            LLMError: nothing failed, but the run was interrupted.
        """
        rest = [fault for _, request, fault in self._all if not self._is_about_the_request(request, fault)]
        final = [fault for fault in rest if fault.kind is not FaultKind.passing]
        if final:
            raise ConfigError(f"{self.name}: the server refuses the key, the model or a setting: {final[0].message}")
        if rest:
            raise TransportError(
                f"{len(rest)} of {requests} requests failed after all tries, the first with {rest[0].message}; give "
                "the same command again: what came is recorded"
            )
        if interrupted:
            raise LLMError(f"{self.name}: interrupted; give the same command again: what came is recorded")

    def _is_about_the_request(self, request: Request, fault: Fault) -> bool:
        doubtful = fault.kind is FaultKind.doubtful and self.models.answers(request)
        return doubtful or fault.kind is FaultKind.request

    def _in_place(self, request: Request, fault: Fault) -> Completion:
        return Completion(
            text="",
            model=request.model,
            stop_reason=fault.stop_reason,
            input_tokens=0,
            output_tokens=0,
            dropped=self.models.dropped(request),
            delivery=self.delivery,
        )


def checked(completion: Completion) -> Completion:
    """Refuse an answer whose fields are not what their types say: the SDKs hand on what came.

    Raises:
        FaultError: a field is missing or of another type; the server may answer properly when it is asked again.
    """
    counts = (completion.input_tokens, completion.output_tokens)
    texts = (completion.text, completion.model, completion.stop_reason)
    if all(isinstance(count, int) for count in counts) and all(isinstance(text, str) for text in texts):
        return completion
    raise FaultError(Fault(kind=FaultKind.passing, message=f"the body is no answer: {counts}, {texts[1:]}"))


def without_secrets(text: str, secrets: tuple[str, ...]) -> str:
    """Black out what must be seen nowhere."""
    for secret in secrets:
        text = text.replace(secret, "***")
    return text


def scrubbed(completion: Completion, secrets: tuple[str, ...]) -> Completion:
    """Black secrets out of an answer: a server, or a proxy before it, may echo what it was sent."""
    return replace(
        completion,
        text=without_secrets(completion.text, secrets),
        model=without_secrets(completion.model, secrets),
        stop_reason=without_secrets(completion.stop_reason, secrets),
    )
