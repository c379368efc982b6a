"""A dictionary that is a value: what grows from it shares its entries, and it stays what it was."""

from bisect import bisect_left
from collections.abc import Hashable, Iterator, Mapping
from itertools import islice
from typing import TypeVar

K = TypeVar("K", bound=Hashable)

V = TypeVar("V")


class Growing(Mapping[K, V]):
    """A mapping without a way to change it, whose keys are in the order in which they first came.

    Mappings that grew from one another share one log of writes, to which only the longest of them appends; each knows
    how many writes it is made of, and so stays what it was. One that grows a second time copies its part of the log
    first. The log keeps values that were replaced.
    """

    __slots__ = ("_keys", "_log", "_places", "_writes")

    def __init__(self) -> None:
        self._log: list[V] = []
        #: Where in the log the values of a key stand, in order.
        self._places: dict[K, list[int]] = {}
        #: How many writes, and how many keys, are this mapping's own.
        self._writes = self._keys = 0

    def adding(self, key: K, value: V) -> "Growing[K, V]":
        """Return the mapping with a value under a key, new or instead of its former value; this one stays as it is."""
        grown: Growing[K, V] = Growing()
        if self._writes == len(self._log):
            grown._log, grown._places = self._log, self._places
        else:
            grown._log, grown._places = list(self.values()), {name: [index] for index, name in enumerate(self)}
        places = grown._places.setdefault(key, [])
        places.append(len(grown._log))
        grown._log.append(value)
        grown._writes, grown._keys = len(grown._log), self._keys + (len(places) == 1)
        return grown

    def __getitem__(self, key: K) -> V:
        """Return the value of a key.

        Raises:
            KeyError: there is no such key.
        """
        if self._writes == len(self._log):  # nothing has grown from it, as is usual
            return self._log[self._places[key][-1]]
        places = self._places.get(key, [])
        own = bisect_left(places, self._writes)
        if own == 0:
            raise KeyError(key)
        return self._log[places[own - 1]]

    def __iter__(self) -> Iterator[K]:
        """Iterate over the keys in the order in which they first came."""
        return iter(list(islice(self._places, self._keys)))

    def __len__(self) -> int:
        """Return the number of keys."""
        return self._keys
