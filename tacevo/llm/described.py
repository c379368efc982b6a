"""What a model takes is known before the first request is sent: it is asked for once, recorded, and checked.

A replay sends no request, so it asks nothing. What a server does not tell stops no run.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace

from tacevo.llm.capabilities import Capabilities, Catalogue, question, read_capabilities, recorded_capabilities
from tacevo.llm.recording import unkept
from tacevo.parts.provider import Keep, Provider
from tacevo.records import Completion, Mode, Request, to_json
from tacevo.storage.store import Store


@dataclass(slots=True)
class DescribedLLM:
    """Lets requests through to a provider once what its model takes has been checked."""

    inner: Provider
    #: Tells of the models; None where nothing can be asked.
    catalogue: Catalogue | None
    _: KW_ONLY
    #: The store `models`.
    store: Store
    mode: Mode
    #: The name of the provider, and that of another server than its own; empty for its own.
    provider: str
    server: str = ""
    #: The models that are asked: by their names in records those at the server.
    models: Mapping[str, str]
    #: Called once, with what is known of each model; raises where a setting cannot act.
    check: Callable[[Mapping[str, Capabilities]], None]
    _is_checked: bool = field(init=False, default=False)

    def complete(self, requests: Sequence[Request], keep: Keep = unkept) -> Iterator[tuple[int, Completion]]:
        """Answer requests (see `tacevo.parts.provider.Provider`).

        Raises:
            ConfigError: the model does not take a setting that was chosen; nothing was sent.
            StoreError: what is recorded of the model is damaged, or cannot be written.
        """
        if not self._is_checked:
            self.check({name: self._known(name, served_as) for name, served_as in self.models.items()})
            self._is_checked = True
        yield from self.inner.complete(requests, keep)

    def _known(self, model: str, served_as: str) -> Capabilities:
        """Return what an earlier run was told, or else ask; only what a server tells is recorded."""
        known = None
        if self.mode is not Mode.live:
            known = recorded_capabilities(self.store, self.provider, model, self.server)
        if self.catalogue is None:
            return known or Capabilities()
        if known is None:
            known = read_capabilities(self.catalogue.ask(served_as))
            if known != Capabilities():
                asked = question(self.provider, model, self.server)
                self.store.keep(asked, to_json(replace(known, temperature=None)))
        return known if known.retires else replace(known, retires=self.catalogue.end(served_as))
