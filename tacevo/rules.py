"""The rules that results are made under: a number for each part of the code whose change may change a result.

The first line of a ledger records the numbers of its run. A replay reads the stores under the recorded numbers, so
recorded verdicts, profiles and trainings outlive the code that made them. Raise a number in `CURRENT` with every change
of its part that may give another answer; docs/publishing.md says what a raise costs the users.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Self

from tacevo.errors import RunError
from tacevo.records import STRICT, Json


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """What decides the results of a search, beside its configuration."""

    __pydantic_config__ = STRICT

    #: Extraction and policy; part of the key of every verdict on an answer.
    static: int
    #: Probe and tracer; part of the key of every profile.
    probe: int
    #: Trainer and judgement of its answer; part of the key of every evaluation.
    training: int
    #: The pure core: descriptors, archives, temperature, prompts, proposals. It is computed anew in every replay.
    #: From 2 on, a candidate's line names the sampling settings that were not sent.
    core: int

    @classmethod
    def from_json(cls, value: Mapping[str, Json]) -> Self:
        """Read what `recorded` wrote.

        Raises:
            ValueError: a number is missing, is not an integer, or is one too many.
        """
        names = set(cls.__dataclass_fields__)
        if value.keys() != names or not all(type(number) is int for number in value.values()):
            raise ValueError(f"expected rules with an integer for each of {sorted(names)}; got {dict(value)}")
        return cls(**value)


#: Rules of the runs whose ledgers record none: those of the first published runs.
FIRST = Rules(static=1, probe=4, training=1, core=1)

#: Rules that this code follows.
CURRENT = Rules(static=2, probe=5, training=2, core=2)

#: Numbers of the core that this code can compute. Remove one only with its last release in `LAST_RELEASES`.
CORES = frozenset({1, 2})

#: Numbers of training whose bits this code's trainer gives, so that `--retrain` can compare them. Those of 1 it gives
#: for candidates that the policy of today lets through: one that redefined what a module is asked trained as it said.
TRAININGS = frozenset({1, 2})

#: The last release that has what this code has dropped, by part and number.
LAST_RELEASES: Mapping[tuple[str, int], str] = {}

#: Number of full trainings of studies that record none, and the number that this code follows.
FIRST_STUDY = 2

STUDY = 3

#: Number of summaries and tables of runs that record none, and the number that this code writes. They follow from the
#: records and decide nothing, so a replay compares the texts of its own number only.
FIRST_PAGES = 1

PAGES = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Era:
    """Generations of a run that were made under the same rules: a run that was continued later may have several."""

    #: The first generation.
    generation: int
    rules: Rules

    def line(self) -> dict[str, Json]:
        """Write the ledger line with which the era begins; the first era begins with the run's header."""
        return {"kind": "rules", "generation": self.generation, "rules": asdict(self.rules)}


def recorded(rules: Rules) -> dict[str, Json]:
    """Write what a ledger's header records; nothing for the first rules, whose headers had no field for them."""
    return {} if rules == FIRST else {"rules": asdict(rules)}


def eras_of(ledger: Sequence[Mapping[str, Json]]) -> tuple[Era, ...]:
    """List the eras of a run, in order.

    Args:
        ledger: its lines, with the header at least.

    Raises:
        ValueError: a line does not record rules as this package writes them.
    """
    eras = [Era(generation=0, rules=_first(ledger))]
    for line in ledger:
        if line["kind"] == "rules":
            eras.append(Era(generation=line["generation"], rules=Rules.from_json(line["rules"])))
            if eras[-1].generation <= eras[-2].generation:
                raise ValueError(f"expected eras that begin one after the other; got generation {line['generation']}")
    return tuple(eras)


def eras_in_words(eras: Sequence[Era]) -> str:
    """Write the numbers that a run began with, and from which generation on which of them changed.

    Args:
        eras: those of one run, in order; at least one.
    """
    begun, *_ = eras
    words = [", ".join(f"{part} {number}" for part, number in asdict(begun.rules).items())]
    for before, era in pairwise(eras):
        changed = asdict(era.rules).items() - asdict(before.rules).items()
        words.append(f"from generation {era.generation} " + ", ".join(f"{part} {to}" for part, to in sorted(changed)))
    return "; ".join(words)


def by_rules(ledger: Sequence[Mapping[str, Json]]) -> Iterator[tuple[Rules, Mapping[str, Json]]]:
    """Yield every line with the rules that it was made under."""
    rules = _first(ledger)
    for line in ledger:
        if line["kind"] == "rules":
            rules = Rules.from_json(line["rules"])
        yield rules, line


def _first(ledger: Sequence[Mapping[str, Json]]) -> Rules:
    """Read the rules that a run began under."""
    header = ledger[0].get("rules")
    return FIRST if header is None else Rules.from_json(header)


def check_known(part: str, number: int, known: frozenset[int], place: object) -> None:
    """Check that this code can still compute what a run was made with.

    Args:
        part: of the code: `core` or `training`.
        number: what the run recorded.
        known: what this code has.
        place: of the run, for the message.

    Raises:
        RunError: it cannot; the message names the release that can, and how to get it.
    """
    if number in known:
        return
    release = LAST_RELEASES.get((part, number))
    remedy = (
        "a later release made it: update tacevo"
        if release is None
        else f"release {release} can: git checkout v{release} && make setup"
    )
    listed = ", ".join(map(str, sorted(known)))
    raise RunError(
        f"{place} was made under {part} rules {number}; this release computes {part} rules {listed}; {remedy}"
    )
