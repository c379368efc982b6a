"""Descriptors: what an axis of the network archive measures."""

import math
from dataclasses import dataclass

from tacevo.parts import Descriptor
from tacevo.profile import Profile


@dataclass(frozen=True)
class Mine(Descriptor):
    """The size of a network: the decimal logarithm of its parameters."""

    def describe(self, profile: Profile) -> float:
        """Return a finite number of what the probe measured."""
        return math.log10(1 + profile.parameters)
