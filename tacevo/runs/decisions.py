"""The parts that decide in a run: ours, as they are; those that a user brought, in confined processes, through a store.

A decision is an answer like any other: it is kept under the hash of its question, so a replay recalls it and runs
nothing of the part. Asked to (`trusts`), a replay lets the recorded sources decide again, confined, and compares.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

import numpy as np

from tacevo.config.recorded_parts import brought, code_hash, decision
from tacevo.config.schema import RunConfig
from tacevo.errors import DivergenceError, PartError, RunError
from tacevo.parts import (
    Archive,
    Candidate,
    Descriptor,
    Fitness,
    Generation,
    Parents,
    Population,
    PromptHistory,
    Prompts,
    Temperature,
)
from tacevo.parts.kinds import ARCHIVES, DESCRIPTORS, FITNESS, PARENTS, PROMPTS, TEMPERATURES, Kind
from tacevo.parts.registry import of_settings
from tacevo.parts.sources import check_texts, recalled
from tacevo.profile import Profile
from tacevo.records import Json, to_json
from tacevo.rounding import rounded
from tacevo.sandbox.part_process import PartProcess, Recorded
from tacevo.storage.canonical import canonical
from tacevo.storage.run_directory import PARTS, RunDirectory
from tacevo.storage.store import Store
from tacevo.text import listed

C = TypeVar("C", bound=Candidate)


class Decisions:
    """The decisions of a user's parts: recalled from a store, or made now and kept there.

    Args:
        store: of the kind `decisions`; None to keep none, as for an estimate.
        trusts: whether decisions that are recalled are made again, and compared.
    """

    def __init__(self, store: Store | None, *, trusts: bool = False) -> None:
        self._store, self.trusts = store, trusts
        self._process = PartProcess()
        #: The number of decisions of each part, by the setting that chose it.
        self.counts: dict[str, int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.close()

    def check(self, part: Recorded, constants: Mapping[str, bool]) -> None:
        """Compare the recorded constants of a part's class with those that its recorded sources have, where trusted.

        Raises:
            DivergenceError: they differ.
        """
        if self.trusts:
            told = self._process.ask(part, "describe", {"constants": list(constants)})
            now = told.get("constants") if isinstance(told, Mapping) else None
            if now != constants:
                expected = f"{canonical(now)}, as its recorded sources have"
                raise DivergenceError(canonical(dict(constants)), place=f"{part.place}, its class", expected=expected)

    def ask(self, part: Recorded, method: str, given: Json) -> Json:
        """Return the decision of a part.

        Raises:
            PartError: as `PartProcess.ask`.
            CacheMissError: this is a replay, and the decision was not recorded.
            DivergenceError: the part decides otherwise than it is recorded.
        """
        self.counts[part.place] = self.counts.get(part.place, 0) + 1
        if self._store is None:
            return self._process.ask(part, method, given)
        request = decision(part.sha256, part.settings, method, given)
        recorded = self._store.find(request)
        if recorded is None:
            return self._store.keep(request, self._process.ask(part, method, given))
        if self.trusts and canonical(now := self._process.ask(part, method, given)) != canonical(recorded):
            expected = f"{canonical(now)[:200]}, which its recorded sources decide"
            raise DivergenceError(canonical(recorded)[:200], place=f"{part.place}, {method}", expected=expected)
        return recorded


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """The parts that decide in a run, by its configuration."""

    config: RunConfig
    decisions: Decisions
    #: Sources by file of the parts that a user brought, by name.
    sources: Mapping[str, Mapping[str, str]]

    @classmethod
    def of(cls, config: RunConfig, decisions: Decisions, run: Path | None = None) -> Self:
        """Find the sources of the parts that a user brought: in the directory of a run, or where composing read them.

        Raises:
            RunError: they are not there, or are not those that the configuration records.
        """
        return cls(config=config, decisions=decisions, sources=sources_of(config, run))

    def parents(self) -> Parents:
        """Return who chooses parents."""
        proposals = self.config.proposals
        parents: Parents = self._part(PARENTS, proposals.parents, proposals)
        return parents

    def prompts(self) -> Prompts:
        """Return who draws instructions."""
        prompts: Prompts = self._part(PROMPTS, self.config.prompts.policy, self.config.prompts)
        return prompts

    def temperature(self) -> Temperature:
        """Return who moves the temperature."""
        settings = self.config.temperature
        temperature: Temperature = self._part(TEMPERATURES, settings.rule, settings)
        return temperature

    def fitness(self) -> Fitness:
        """Return what the fitness of a training is."""
        training = self.config.training
        fitness: Fitness = self._part(FITNESS, training.fitness, training)
        return fitness

    def archive(self) -> Archive:
        """Return who says where the niches are."""
        archive: Archive = self._part(ARCHIVES, self.config.archive.kind, self.config.archive)
        return archive

    def axes(self) -> dict[str, Descriptor]:
        """Return what measures the axes of the archive, by name, in their order."""
        settings = self.config.archive
        return {name: self._part(DESCRIPTORS, name, settings) for name in settings.axes}

    def _part(self, kind: Kind, name: str, settings: object) -> Any:
        if name in kind.ours:
            return of_settings(kind, name, settings)
        code = self.config.code[name]
        part = Recorded(
            kind=kind,
            name=name,
            module=code.module,
            attribute=code.attribute,
            sources=self.sources[name],
            sha256=code.sha256,
            settings=dict(self.config.parts.get(name, {})),
        )
        self.decisions.check(part, dict(code.constants))
        return brought_part(part, code.constants, self.decisions)


def sources_of(config: RunConfig, run: Path | None) -> dict[str, dict[str, str]]:
    """Return the sources of the parts that a user brought, by name and file; see `Parts.of`."""
    found = {}
    for kind, name in brought(config):
        code = config.code[name]
        texts = (None if run is None else RunDirectory(run).read_part(name)) or recalled(code.sha256)
        sha256 = code_hash(code.module, code.attribute, texts or {})
        if texts is None or sha256 != code.sha256:
            raise RunError(
                "no sources" if texts is None else f"sources of the hash {sha256[:12]}: they were edited",
                place=f"{run}/{PARTS}/{name}" if run else f"{kind.setting}={name}",
                expected=f"the sources of the part that decided, of the hash {code.sha256[:12]}",
                remedy="restore them" if texts is None else f"restore them; there are {listed(texts)}",
            )
        check_texts(f"{kind.setting}={name}", texts)
        found[name] = dict(texts)
    return found


class Asked(Protocol):
    """The protocol of what gives a part's decisions, as `Decisions` does."""

    def ask(self, part: Recorded, method: str, given: Json) -> Json:
        """Return the decision of a part."""
        ...


def brought_part(part: Recorded, constants: Mapping[str, bool], decisions: Asked) -> Any:
    """Return a part that a user brought as the search sees it: what it decides is checked.

    A method of it raises a `PartError` where a decision is none.
    """
    kind = _BROUGHT[part.kind]
    own = type(kind.__name__, (kind,), {})
    for name, value in constants.items():
        setattr(own, name, value)
    return own(part, decisions)


class _Brought:
    """A part that a user brought, as the search sees it; what it returns is checked."""

    def __init__(self, part: Recorded, decisions: Asked) -> None:
        self._recorded, self._decisions = part, decisions

    def _ask(self, method: str, given: Json) -> Json:
        return self._decisions.ask(self._recorded, f"{self._recorded.kind.name}.{method}", given)

    def _number(self, method: str, given: Json) -> float:
        answer = self._ask(method, given)
        self._check(isinstance(answer, float), method, answer, "a number")
        return float(answer)  # type: ignore[arg-type]

    def _check(self, holds: bool, method: str, answer: Json, expected: str) -> None:
        if not holds:
            place = f"{self._recorded.place}, {self._recorded.kind.name}.{method}"
            raise PartError(canonical(answer)[:200], place=place, expected=expected)


class _Parents(_Brought, Parents):
    def pool(self, population: Population) -> Sequence[Candidate]:
        if not self.chooses_pool:
            return population.elites
        given: Json = {
            "generation": population.generation,
            "candidates": [_seen(one) for one in population.candidates.values()],
            "elites": [one.id for one in population.elites],
        }
        return self._among(population.candidates, "pool", self._ask("pool", given))

    def draw(self, pool: Sequence[C], number: int, rng: np.random.Generator) -> Sequence[C]:
        given: Json = {"pool": [_seen(one) for one in pool], "number": number, "rng": _key(rng)}
        drawn = self._among({one.id: one for one in pool}, "draw", answer := self._ask("draw", given))
        self._check(len(drawn) == number, "draw", answer, f"{number} candidates of the pool")
        return drawn

    def _among(self, known: Mapping[str, C], method: str, answer: Json) -> list[C]:
        names = answer if isinstance(answer, list) else [answer]
        sound = len(set(map(canonical, names))) == len(names) and all(
            isinstance(one, str) and one in known for one in names
        )
        self._check(sound, method, answer, "candidates that it was given, each once")
        return [known[str(name)] for name in names]


class _Prompts(_Brought, Prompts):
    def draw(self, history: PromptHistory, pool: Sequence[int], rng: np.random.Generator) -> int:
        given: Json = {
            "trials": to_json(history.trials),
            "changes": {str(prompt): list(change) for prompt, change in sorted(history.changes.items())},
            "pool": list(pool),
            "rng": _key(rng),
        }
        drawn = self._ask("draw", given)
        self._check(drawn in pool, "draw", drawn, "an instruction of the pool")
        return int(drawn)  # type: ignore[arg-type]


class _Temperature(_Brought, Temperature):
    def next(self, ended: Generation) -> float:
        return self._number("next", {"ended": to_json(ended)})


class _Fitness(_Brought, Fitness):
    def of(self, losses: Sequence[float]) -> float:
        return rounded(self._number("of", {"losses": list(losses)}))


class _Descriptor(_Brought, Descriptor):
    def describe(self, profile: Profile) -> float:
        return rounded(self._number("describe", {"profile": to_json(profile)}))


class _Archive(_Brought, Archive):
    def centroids(self, niches: int, axes: int) -> Sequence[Sequence[float]]:
        given: Json = {"niches": niches, "axes": axes}
        answer = self._ask("centroids", given)
        points = answer if isinstance(answer, list) else []
        sound = len(points) == niches and all(_is_point(point, axes) for point in points)
        self._check(sound, "centroids", answer, f"{niches} points of {axes} coordinates in [0, 1]")
        return [[float(value) for value in point] for point in points]


#: The classes of brought parts, by kind.
_BROUGHT: Mapping[Kind, type[_Brought]] = {
    PARENTS: _Parents,
    PROMPTS: _Prompts,
    TEMPERATURES: _Temperature,
    FITNESS: _Fitness,
    DESCRIPTORS: _Descriptor,
    ARCHIVES: _Archive,
}


def _is_point(point: Json, axes: int) -> bool:
    """Answer whether this is a point of the unit cube."""
    return (
        isinstance(point, list)
        and len(point) == axes
        and all(isinstance(value, float) and 0 <= value <= 1 for value in point)
    )


def _seen(candidate: Candidate) -> dict[str, Json]:
    """Write what a part sees of a candidate."""
    return {
        "id": candidate.id,
        "source": candidate.source,
        "fitness": candidate.fitness,
        "losses": list(candidate.losses),
        "parameters": candidate.parameters,
        "flops": candidate.flops,
        "parents": list(candidate.parents),
        "curiosity": candidate.curiosity,
    }


def _key(rng: np.random.Generator) -> list[int]:
    """Return what a stream is made of again: it has not been drawn from."""
    state = rng.bit_generator.state["state"]
    assert not state["counter"].any()
    return [int(word) for word in state["key"]]
