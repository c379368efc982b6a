"""The moves of the sampling temperature (paper, Algorithm 1, line 9): the paper's rule, and controls; pure."""

from dataclasses import dataclass

from tacevo.parts import Generation, Temperature


@dataclass(frozen=True)
class Fixed(Temperature):
    """A temperature that stays as it is."""

    def next(self, ended: Generation) -> float:
        """Return T_g."""
        return ended.temperature


@dataclass(frozen=True)
class Paper(Temperature):
    """The formula as printed: up when the archive's best is not worse than before, else down.

    An archive's best never gets worse, so it only ever rises.
    """

    #: eta, in [0, 1].
    step: float

    def next(self, ended: Generation) -> float:
        """Return T_(g+1)."""
        return clip(ended.temperature + (self.step if ended.best <= ended.best_before else -self.step))


@dataclass(frozen=True)
class Stall(Temperature):
    """Up when the generation brought no better best, down when it did."""

    #: eta, in [0, 1].
    step: float

    def next(self, ended: Generation) -> float:
        """Return T_(g+1)."""
        return clip(ended.temperature + (self.step if ended.best >= ended.best_before else -self.step))


def clip(temperature: float) -> float:
    """Bring a temperature into [0, 1]; rounded to 12 decimals, so that steps of 0.05 do not gather dust."""
    return round(min(max(temperature, 0.0), 1.0), 12)
