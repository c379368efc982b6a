"""Claude as a provider, one by one or in batches."""

from functools import partial

from tacevo.llm.anthropic import ClaudeCatalogue, connect, connect_batches
from tacevo.llm.hosted import asking, completions, models_of
from tacevo.parts.making import Given
from tacevo.parts.provider import Provider
from tacevo.records import Delivery


def from_settings(given: Given) -> Provider:
    """Make what asks Claude by the settings of `llm`: one by one, or a generation as one Message Batch.

    Raises:
        ConfigError: as `connect`.
    """
    catalogue = ClaudeCatalogue(given.settings["base_url"])
    if given.settings["delivery"] is Delivery.direct:
        return asking(given, connect, catalogue)
    from tacevo.llm.batches import BatchLLM

    connected = partial(connect_batches, given.settings["base_url"])
    connected().close()  # a missing key is reported at once
    store, directory = completions(given.root), given.root / "batches"
    return BatchLLM(connected, store=store, directory=directory, models=models_of(given, catalogue))
