"""The steps of a network as a graph that can be walked, with some operands left out where a reader asks for that."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Self

from tacevo.profile import Profile, Step


@dataclass(frozen=True, slots=True, kw_only=True)
class Flow:
    """Steps, which of them lead to the output, and along which operands."""

    steps: tuple[Step, ...]
    ends: tuple[int, ...]
    #: (step, number of its operand) that are not followed.
    cut: frozenset[tuple[int, int]] = frozenset()
    #: The steps that the output comes from.
    live: frozenset[int]

    @classmethod
    def of(cls, profile: Profile) -> Self:
        """Follow every operand of a probed network."""
        whole = cls(steps=profile.steps, ends=profile.output, live=frozenset())
        return replace(whole, live=whole.reaching(profile.output))

    def without(self, cut: Iterable[tuple[int, int]]) -> "Flow":
        """Leave further operands out."""
        less = replace(self, cut=self.cut | frozenset(cut))
        return replace(less, live=less.reaching(self.ends))

    def sources(self, index: int) -> tuple[int, ...]:
        """Return the steps directly behind a step."""
        operands = enumerate(self.steps[index].sources)
        return tuple(source for number, sources in operands if (index, number) not in self.cut for source in sources)

    def reaching(self, ends: Iterable[int]) -> frozenset[int]:
        """Return steps and everything behind them."""
        reached: set[int] = set()
        waiting = list(ends)
        while waiting:
            index = waiting.pop()
            if index not in reached:
                reached.add(index)
                waiting += self.sources(index)
        return frozenset(reached)

    def nearest(self, index: int, wanted: Callable[[Step], bool]) -> frozenset[int]:
        """Return the first wanted step behind a step, on every path."""
        reached: set[int] = set()
        seen: set[int] = set()
        waiting = list(self.sources(index))
        while waiting:
            other = waiting.pop()
            if other in seen:
                continue
            seen.add(other)
            if wanted(self.steps[other]):
                reached.add(other)
            else:
                waiting += self.sources(other)
        return frozenset(reached)

    def longest(self, counted: Callable[[Step], bool]) -> int:
        """Count the steps of a sort on the path to the output that has most of them."""
        most: dict[int, int] = {}
        for index in sorted(self.live):  # sources come before their step
            behind = max((most[source] for source in self.sources(index)), default=0)
            most[index] = behind + counted(self.steps[index])
        return max(most.values(), default=0)
