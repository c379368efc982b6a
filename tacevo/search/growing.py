"""A mapping that grows by new mappings instead of changing, each in constant time: pure, like the core that uses it."""

from bisect import bisect_left
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Growing(Mapping[str, T]):
    """A mapping without a way to change it, whose keys are in the order in which they first came.

    Mappings that grew from one another share one log of writes, to which only the longest of them appends; each knows
    how many writes it is made of, and so stays what it was. One that grows a second time copies its part of the log
    first. The log keeps values that were replaced.
    """

    _log: list[T] = field(default_factory=list)
    #: Where in the log the values of a key stand, in order.
    _places: dict[str, list[int]] = field(default_factory=dict)
    #: How many writes, and how many keys, are this mapping's own.
    _writes: int = 0
    _keys: int = 0

    def adding(self, key: str, value: T) -> "Growing[T]":
        """Return the mapping with a value under a key, new or instead of its former value; this one stays as it is."""
        if self._writes < len(self._log):
            return self._copied().adding(key, value)
        places = self._places.setdefault(key, [])
        places.append(self._writes)
        self._log.append(value)
        return Growing(self._log, self._places, self._writes + 1, self._keys + (len(places) == 1))

    def __getitem__(self, key: str) -> T:
        """Return the value of a key.

        Raises:
            KeyError: there is no such key.
        """
        places = self._places.get(key, [])
        own = bisect_left(places, self._writes)
        if own == 0:
            raise KeyError(key)
        return self._log[places[own - 1]]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the keys in the order in which they first came."""
        return iter(list(islice(self._places, self._keys)))

    def __len__(self) -> int:
        """Return the number of keys."""
        return self._keys

    def _copied(self) -> "Growing[T]":
        """Return an equal mapping with a log of its own."""
        places = {key: [index] for index, key in enumerate(self)}
        return Growing(list(self.values()), places, self._keys, self._keys)
