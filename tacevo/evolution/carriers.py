"""The carriers of a request's temperature T: what the request holds of it; pure.

The paper sends T as the sampling temperature. Many models refuse that one, so T can choose a sentence of the task's
library instead, or the model's effort. Each of several equal parts of [0, 1] stands for one of these.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from tacevo.choices import Carrier, Effort

#: The number of sentences that carry a temperature.
LEVELS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Carried:
    """The temperature T of a request, and what the request holds of it."""

    #: T in [0, 1], its noise included.
    temperature: float
    #: The sampling temperature that is sent: T, or None.
    parameter: float | None = None
    #: The number of the sentence, or of the effort, from 1.
    level: int | None = None
    #: The paragraph of the user message that holds the sentence, with the blank line behind it; else empty.
    words: str = ""
    effort: Effort | None = None


def carry(temperature: float, *, by: Carrier, sentences: Sequence[str], efforts: Sequence[Effort]) -> Carried:
    """Return what a request holds of a temperature in [0, 1].

    Args:
        temperature: T of the request, its noise included.
        by: the carrier.
        sentences: those of the library, `LEVELS` of them; none for a request without a parent to depart from, of which
            words say nothing.
        efforts: those that the model takes, rising; at least one with `Carrier.effort`.
    """
    if by is Carrier.parameter:
        return Carried(temperature=temperature, parameter=temperature)
    if by is Carrier.words and sentences:
        level = part_of(temperature, len(sentences))
        return Carried(temperature=temperature, level=level + 1, words=boldness_text(level + 1, sentences[level]))
    if by is Carrier.effort:
        level = part_of(temperature, len(efforts))
        return Carried(temperature=temperature, level=level + 1, effort=efforts[level])
    return Carried(temperature=temperature)


def part_of(temperature: float, parts: int) -> int:
    """Return the one of so many equal parts of [0, 1] that a temperature lies in, from 0; the last one holds 1."""
    return min(int(temperature * parts), parts - 1)


def boldness_text(level: int, sentence: str) -> str:
    """Write the paragraph that carries a temperature in words; the grammar reads its number."""
    return f"Boldness {level} of {LEVELS}: {sentence}\n\n"
