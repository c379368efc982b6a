"""The embedded provider: answers requests from the grammar, without a network connection or a key.

It promises: equal requests get equal answers, whatever was asked before; an answer without a slip holds a network
that builds and trains. It does not promise to understand a parent that another model wrote: then it says so in
words, and the gate rejects that answer. Where its answer is sent back, it draws another one to the first message; it
does not read what was wrong.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacevo.choices import Effort
from tacevo.errors import ConfigError
from tacevo.evolution.carriers import LEVELS
from tacevo.evolution.prompts import sample_text
from tacevo.evolution.told import asks_edits, asks_note, without_told
from tacevo.llm.grammar.crossover import cross
from tacevo.llm.grammar.instructions import transform
from tacevo.llm.grammar.network import Network
from tacevo.llm.grammar.parsing import UnreadableError, parse
from tacevo.llm.grammar.slips import Slip, draw, proper, spoil
from tacevo.llm.grammar.space import crossed, mutated, wandered
from tacevo.llm.grammar.variations import wander, warm
from tacevo.llm.prices import CHARACTERS_PER_TOKEN, likely_tokens
from tacevo.llm.recording import unkept
from tacevo.parts.making import Given
from tacevo.parts.provider import Keep
from tacevo.randomness import stream
from tacevo.records import Completion, Request, to_json
from tacevo.space import Space
from tacevo.storage.canonical import content_hash
from tacevo.text import counted

#: The model that every completion names; the name changes whenever equal requests may get other answers.
MODEL = "grammar-2"

_PARENT = re.compile(r"```python\n(.*?)\n?```", re.DOTALL)

#: The paragraph before the instruction that carries a temperature in words (`tacevo.evolution.carriers`).
_BOLDNESS = re.compile(rf"^Boldness ([1-{LEVELS}]) of {LEVELS}: [^\n]*\n\n(?=Instruction: )", re.MULTILINE)

#: The temperature of a request that says nothing of one.
UNSAID = 0.5

_INSTRUCTION = re.compile(r"^Instruction: (.*)\Z", re.DOTALL | re.MULTILINE)


def from_settings(given: Given) -> "GrammarLLM":
    """Make the grammar of the settings of `llm`.

    Raises:
        ConfigError: another model than this version's grammar is asked for.
    """
    llm = given.settings
    if llm["models"] is not None:
        _check_names([name for name, _ in llm["models"]])
    elif llm["model"] != MODEL:
        raise ConfigError(
            repr(llm["model"]),
            place="llm.model",
            expected=f"{MODEL} for llm=grammar",
            remedy="an earlier grammar's run replays from its record; a new search asks this one",
        )
    return GrammarLLM(slip_rate=llm["slip_rate"], space=llm["space"])


def _check_names(names: Sequence[str]) -> None:
    """Check the names under which the one grammar stands for several models, to try their choice without a key."""
    for name in names:
        if name != MODEL and not name.startswith(f"{MODEL}-"):
            expected = f"{MODEL}, or a name that begins with {MODEL}-, for llm=grammar"
            raise ConfigError(repr(name), place="llm.models", expected=expected)


@dataclass(frozen=True, slots=True, kw_only=True)
class GrammarLLM:
    """Answers requests for mutations, crossovers and samples with source text from the grammar."""

    #: Probability in [0, 1] that an answer carries one of the faults of `slips.Slip`.
    slip_rate: float
    #: The space in which every network of an answer lies; None for the whole grammar.
    space: Space | None = None

    def complete(self, requests: Sequence[Request], keep: Keep = unkept) -> Iterator[tuple[int, Completion]]:
        """Answer the requests in their order (see `tacevo.parts.provider.Provider`)."""
        for position, request in enumerate(requests):
            yield position, keep(request, answer(request, slip_rate=self.slip_rate, space=self.space))


def answer(request: Request, *, slip_rate: float, space: Space | None = None) -> Completion:
    """Answer one request: a pure function of the request, the slip rate and the space.

    Its first message holds one parent and an instruction for a mutation, two for a crossover; for a sample it is
    `sample_text`, to the letter. The draws depend neither on the slip rate nor on the request's provider settings
    (where a plan records that rate), so runs that differ in it alone share their proper answers; nor on the
    temperature, whatever carries it, so a warmer request gets the same network with further edits (`variations.warm`).

    It makes nothing of what a request tells beside parents and instruction, so its networks do not depend on that.
    Asked for edits, it writes the same network as edits of the first parent; asked for a note, it says how deep it is.
    """
    first, *rest = request.messages
    bare = replace(first, content=_BOLDNESS.sub("", without_told(first.content)))
    known = replace(request, messages=(bare, *rest), settings=(), temperature=0.0)
    digest = content_hash(to_json(known))
    try:
        child = _child(bare.content, strength(request), space, stream(0, "grammar", digest))
    except UnreadableError as error:
        return _completion(request, f"I cannot read the request, so this answer holds no code: {error}.\n")
    rng = stream(0, "grammar", "slip", digest)
    slip = draw(slip_rate, rng)
    parent = _PARENT.findall(bare.content)[0] if asks_edits(first.content) else None
    text = proper(child, parent) if slip is None else spoil(child, slip, rng, parent)
    if asks_note(first.content) and slip is not Slip.cut_off:
        blocks, hidden = len(child.blocks), len(child.head.hidden)
        text += f"\nNOTES: this network has {counted(blocks, 'block')} and {counted(hidden, 'hidden layer')}.\n"
    return _completion(request, text, is_cut=slip is Slip.cut_off)


def strength(request: Request) -> float:
    """Return the temperature of a request, in [0, 1], whatever carries it.

    Of words and effort it is the middle of the part of [0, 1] that they stand for; `UNSAID` where nothing carries one.
    """
    if request.temperature is not None:
        return request.temperature
    if (effort := dict(request.settings).get("effort")) is not None:
        return ([*Effort].index(Effort(str(effort))) + 0.5) / len(Effort)
    words = _BOLDNESS.search(request.messages[0].content)
    return UNSAID if words is None else (int(words[1]) - 0.5) / LEVELS


def _child(content: str, temperature: float, space: Space | None, rng: np.random.Generator) -> Network:
    """Make the network that a message asks for."""
    instruction = _INSTRUCTION.search(content)
    sources = _PARENT.findall(content)
    parents = [parse(source) for source in sources]
    if instruction is None or len(parents) not in {1, 2}:
        raise UnreadableError(f"one or two parents and an instruction were expected; found {len(parents)} parents")
    if content == sample_text(sources[0]):
        return wander(parents[0], rng) if space is None else wandered(space, parents[0], rng)
    if space is not None and len(parents) == 1:
        return mutated(space, parents[0], instruction[1], temperature, rng)
    if space is not None:
        return crossed(space, parents[0], parents[1], temperature, rng)
    if len(parents) == 1:
        return transform(parents[0], instruction[1], rng, temperature)
    return warm(cross(parents[0], parents[1], instruction[1], rng), temperature, rng)


def _completion(request: Request, text: str, *, is_cut: bool = False) -> Completion:
    """Count a token for four characters, rounded up, and cut what is longer than the request allows."""
    asked = request.system + "".join(message.content for message in request.messages)
    longest = request.max_tokens * CHARACTERS_PER_TOKEN
    return Completion(
        text=text[:longest],
        model=MODEL,
        stop_reason="max_tokens" if is_cut or len(text) > longest else "end_turn",
        input_tokens=likely_tokens(asked),
        output_tokens=likely_tokens(text[:longest]),
    )
