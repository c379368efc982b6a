"""Temperatures: how the sampling temperature moves."""

from dataclasses import dataclass

from tacevo.parts import Generation, Temperature


@dataclass(frozen=True)
class Mine(Temperature):
    """A temperature that falls by the same amount in each generation."""

    #: In units of the temperature, which lies in [0, 1].
    step: float = 0.05

    def next(self, ended: Generation) -> float:
        """Return the temperature of the next generation; it is brought into [0, 1]."""
        return ended.temperature - self.step
