"""The requests to models: their texts, and the prompt archive A_P.

The archive holds which instruction at which temperature was productive (paper, Algorithm 1, line 8).
"""

import math
import string
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tacevo.evolution.archive import AddStatus, Archive, Elite, PersistentMap, Point, Tessellation, insert
from tacevo.parts import PromptHistory, Trial
from tacevo.records import ChatMessage, Contract, Reason, Rejection, Request, to_json
from tacevo.storage.canonical import content_hash

#: The instruction of a request for a network without a parent.
SAMPLING = "Draw a network at random."

#: Rejections that no further turn can mend.
_NOT_REPAIRED = frozenset({Reason.empty, Reason.invalid_request, Reason.refused, Reason.too_long})


#: The change of the logarithm of a loss that a child counts as which does not train.
FAILED = 1.0

#: The curiosity of a mutation whose child did not enter the network archive.
UNPRODUCTIVE = 0.5


def curiosity(fitness: float, *, inserted: bool) -> float:
    """Score how much a mutation taught: 1 + 1 / (1 + f) where its child, of loss f, entered the network archive."""
    return 1.0 + 1.0 / (1.0 + fitness) if inserted else UNPRODUCTIVE


@dataclass(frozen=True, slots=True, kw_only=True)
class PromptArchive:
    """A_P: a CVT archive over (prompt index, temperature) in which trials compete by r."""

    archive: Archive = field(default_factory=Archive)
    #: The trials that the archive's elites name, by niche.
    trials: PersistentMap[int, Trial] = field(default_factory=PersistentMap)
    #: The number of children by instruction, and the sum of the changes of the loss's logarithm.
    changes: PersistentMap[int, tuple[int, float]] = field(default_factory=PersistentMap)

    @property
    def history(self) -> PromptHistory:
        """The history that draws of instructions look at."""
        trials = tuple(self.trials[niche] for niche in sorted(self.trials))
        return PromptHistory(trials=trials, changes=self.changes)

    @property
    def digest(self) -> str:
        """The hash of its trials by niche, for the ledger: 64 hex digits."""
        return content_hash(to_json(self.trials))

    def record(
        self, tessellation: Tessellation, trial: Trial, *, prompts: int, name: str
    ) -> tuple["PromptArchive", int, AddStatus]:
        """Let a trial compete for its niche by r: an unproductive one only ever takes an empty niche.

        Return the archive that results, the trial's niche, and what the insertion did. `prompts` is how many
        instructions the task has (`prompt_point`), `name` the candidate that came of the trial.
        """
        niche = tessellation.niche_of(prompt_point(trial.prompt, trial.temperature, prompts=prompts))
        archive, status = insert(self.archive, niche, Elite(name=name, objective=float(trial.inserted)))
        if status is AddStatus.rejected:
            return self, niche, status
        return replace(self, archive=archive, trials=self.trials.adding(niche, trial)), niche, status

    def learning(self, prompt: int, change: float) -> "PromptArchive":
        """Return it with one more child of an instruction: the logarithm of its loss less that of its parent's."""
        count, total = self.changes.get(prompt, (0, 0.0))
        return replace(self, changes=self.changes.adding(prompt, (count + 1, total + change)))


def prompt_point(prompt: int, temperature: float, *, prompts: int) -> Point:
    """Return where an instruction at a temperature stands in A_P, in [0, 1]^2; `prompts` is how many there are."""
    return prompt / max(prompts - 1, 1), temperature


def draw_pool(prompts: int, size: int | None, rng: np.random.Generator) -> tuple[int, ...]:
    """Draw the prompt pool P_g of one generation (paper, Algorithm 1, line 3): different instructions, uniformly.

    Return `size` indices in [0, prompts), ascending; all of them for None, which takes no random number.
    """
    left = list(range(prompts))
    if size is None:
        return tuple(left)
    return tuple(sorted(left.pop(int(rng.integers(len(left)))) for _ in range(size)))


def draw_weighted(weights: list[float], rng: np.random.Generator) -> int:
    """Draw an index in proportion to weights > 0, by one uniform number against their running sum."""
    target = rng.random() * math.fsum(weights)
    running = 0.0
    for index, weight in enumerate(weights):
        running += weight
        if target < running:
            return index
    return len(weights) - 1  # rounding may leave the target at the very end


def system_prompt(template: str, contract: Contract, names: Sequence[str]) -> str:
    """Fill a task's system prompt in with its contract.

    Raises:
        ValueError: the template names an unknown placeholder; the message lists the known ones.
    """
    values: Mapping[str, object] = {
        "class_name": contract.class_name,
        "in_channels": contract.in_channels,
        "image_size": contract.image_size,
        "outputs": contract.outputs,
        "output_argument": contract.output_argument,
        "names": ", ".join(names),
    }
    try:
        return string.Template(template).substitute(values)
    except KeyError as error:
        known = ", ".join(f"${name}" for name in values)
        raise ValueError(f"the system prompt names ${error.args[0]}; it may name {known}") from error


def mutation_text(parent: str, instruction: str, *, boldness: str = "") -> str:
    """Write the user message of a mutation; `boldness` is the paragraph that carries its temperature, if one does."""
    return f"Parent network:\n\n{_fenced(parent)}\n\n{boldness}Instruction: {instruction}\n"


def crossover_text(first: str, second: str, instruction: str, *, boldness: str = "") -> str:
    """Write the user message of a crossover; `boldness` as of a mutation."""
    return (
        f"First parent network:\n\n{_fenced(first)}\n\nSecond parent network:\n\n{_fenced(second)}\n\n"
        f"{boldness}Instruction: {instruction}\n"
    )


def sample_text(example: str) -> str:
    """Write the user message that asks for a network without a parent; only the grammar is asked this."""
    return f"Example, for its interface alone:\n\n{_fenced(example)}\n\nInstruction: {SAMPLING}\n"


def repair_request(request: Request, answer: str, rejection: Rejection, *, edits: bool = False) -> Request | None:
    """Ask for a corrected answer: the conversation so far, and why the gate rejected its last answer.

    `edits` is whether an answer may be edits of the parent.

    Temperature and draw number are those of the first request; the longer conversation makes it another request.
    Return None if nothing can be corrected: no answer, a refusal, or one too long to send back.
    """
    if rejection.reason in _NOT_REPAIRED or not answer.strip():
        return None
    turns = (
        ChatMessage(role="assistant", content=answer),
        ChatMessage(role="user", content=repair_text(rejection, edits=edits)),
    )
    return replace(request, messages=(*request.messages, *turns))


def repair_text(rejection: Rejection, *, edits: bool = False) -> str:
    """Write the user message that sends an answer back.

    It is part of the request's key: another wording, here or of the gate's `detail`, asks a model again.
    """
    again = "answer with the whole class again"
    if edits:
        again = "answer again in full: with all edits of the parent network as it stands above, or with the whole class"
    return (
        f"This answer cannot be used. It failed at the stage '{rejection.stage}' for the reason '{rejection.reason}': "
        f"{rejection.detail}\n\nCorrect this fault, keep the rest of your design, and {again}.\n"
    )


def _fenced(source: str) -> str:
    return f"```python\n{source.strip()}\n```"
