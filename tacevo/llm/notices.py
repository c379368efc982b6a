"""What a user is told while requests are retried: without it a wrong address would mean minutes of silence."""

import logging

from tacevo.llm.faults import Fault

_LOG = logging.getLogger(__name__)


class Notices:
    """Tells of failed tries that are repeated, once for each kind: a status, or the name of a fault of the connection.

    Args:
        name: what the user chose, e.g. `llm=anthropic`.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._told: set[str] = set()

    def tell(self, fault: Fault, wait: float) -> None:
        """Tell of a fault, unless one of its kind was told of before.

        Args:
            fault: its message holds no secrets.
            wait: seconds until the next try.
        """
        kind = fault.message.partition(":")[0]
        if kind not in self._told:
            self._told.add(kind)
            _LOG.warning(
                "%s: %s; asking again in %.1f s (said once for each kind of fault)", self._name, fault.message, wait
            )
