"""May the runs of a sweep be compared: one set of data, one budget, one set of versions, and one configuration an arm.

Arms differ in how they search. What decides how good a network looks, or how many a search may try, must be the same
in all of them, or a difference between two arms would be one of data, of budget or of software.
"""

import json
from collections.abc import Callable, Iterator
from typing import NoReturn

from analysis.sweeps.sweep import Finished, Sweep
from tacevo.errors import IncomparableError
from tacevo.records import Json
from tacevo.search.lines import eras_in_words
from tacevo.search.unsent import TEMPERATURE
from tacevo.storage.canonical import canonical, differences, shown, value_at

#: Python and the packages that can change a request, a verdict of the gate, a niche or a fitness. The others compose
#: settings, carry answers that are recorded, or mirror what was decided.
VERSIONS = ("python", "tacevo", "torch", "numpy", "scipy", "scikit-learn", "pillow")

#: What an archive of networks may differ in and still be of the same kind as another.
_SIZES = ("niches", "prompt_niches", "samples", "seed")

#: Settings that say where, by whom and under whose eyes a run is computed, or that its data's fingerprint covers.
_INDIFFERENT = frozenset(["seed", "run", "store", "tracking", "executor", "sandbox", "data"])

_INDIFFERENT_LLM = frozenset(["mode", "base_url", "concurrency", "delivery", "budget_usd", "prices"])

_REMEDIES = {
    "data": "All jobs must search on the same data, with the same baseline",
    "budget": "Give all jobs the same; other budgets are a sweep of their own",
    "versions": "Delete the folders of the older jobs, and repeat the command that began the sweep with another "
    "store.root: what the old stores recall is not computed anew, and hides the mixture",
    "archive": "Archives of one kind must have the same niches; other niches are a sweep of their own",
    TEMPERATURE: "Delete the folders of such arms to compare the others; these need a model that takes temperatures",
    "arm": "The runs of an arm may differ in their seed only; delete the folder that does not belong to it",
}


def check_sweep(sweep: Sweep) -> None:
    """Refuse a sweep whose finished jobs are no comparison.

    Raises:
        IncomparableError: two jobs differ in their data, budget, rules or versions, or in the niches of archives that
            are otherwise alike, or two runs of an arm in more than their seed, or jobs in temperatures that the model
            refuses; the message names the jobs, the field and both values.
    """
    first = sweep.finished[0]
    for other in sweep.finished[1:]:
        _check_temperatures(sweep, first, other)
        for (kind, field, one), (_, _, two) in zip(_terms(first), _terms(other), strict=True):
            if one != two:
                _refuse(sweep, kind, field, (first, one), (other, two))
    _compare_with_first(sweep, _kind_of_archive, _archive_fields, "archive")
    _compare_with_first(sweep, lambda one: one.job.arm, arm_settings, "arm")


def _check_temperatures(sweep: Sweep, one: Finished, two: Finished) -> None:
    """Refuse two jobs that differ in temperatures which a model was never sent."""
    idle = [job for job in (one, two) if TEMPERATURE in job.run.not_sent]
    if idle and one.run.config[TEMPERATURE] != two.run.config[TEMPERATURE]:
        raise IncomparableError(
            f"{sweep.path} compares temperatures that had no effect: {one.job.name} and {two.job.name} differ in them, "
            f"and in {idle[0].job.name} {idle[0].run.not_sent[TEMPERATURE]}. {_REMEDIES[TEMPERATURE]}"
        )


def _terms(one: Finished) -> Iterator[tuple[str, str, Json]]:
    """List what must be equal in all jobs: what it belongs to, its name, its value."""
    config = one.run.config
    yield "data", "task.name", one.run.task
    yield "data", "the data's fingerprint", one.run.facts.fingerprint
    yield "data", "the hash of the baseline's source", one.run.baseline.source
    yield "data", "task.loss", config["task"].get("loss")
    yield "budget", "the number of generations", one.run.generations[-1].generation
    for key in ("candidates", "initial"):
        yield "budget", f"search.{key}", config["search"][key]
    for key in ("epochs", "batch_size", "learning_rate", "seconds", "memory_mib", "device"):
        yield "budget", f"training.{key}", config["training"].get(key)
    yield "versions", "the set of rules", eras_in_words(one.run.eras)
    yield "versions", "numerics.kind", config["numerics"]["kind"]
    for name in VERSIONS:
        yield "versions", f"the version of {name}", one.versions.get(name)


def _kind_of_archive(one: Finished) -> str:
    return canonical({key: value for key, value in one.run.config["archive"].items() if key not in _SIZES})


def _archive_fields(one: Finished) -> Json:
    """Give what decides the niches of networks."""
    return {"archive": {key: one.run.config["archive"].get(key) for key in ("niches", "samples", "seed")}}


def arm_settings(one: Finished) -> Json:
    """Give the settings that must be those of the whole arm."""
    config = {key: value for key, value in one.run.config.items() if key not in _INDIFFERENT}
    llm = {key: value for key, value in config.get("llm", {}).items() if key not in _INDIFFERENT_LLM}
    return {**config, "llm": llm}


def _compare_with_first(
    sweep: Sweep, group_of: Callable[[Finished], str], fields_of: Callable[[Finished], Json], kind: str
) -> None:
    """Hold each job against the first one of its group."""
    firsts: dict[str, Finished] = {}
    for other in sweep.finished:
        first = firsts.setdefault(group_of(other), other)
        one, two = fields_of(first), fields_of(other)
        for field in differences(one, two):
            _refuse(sweep, kind, shown(field), (first, value_at(one, field)), (other, value_at(two, field)))


def _refuse(sweep: Sweep, kind: str, field: str, one: tuple[Finished, Json], two: tuple[Finished, Json]) -> NoReturn:
    (first, was), (second, came) = one, two
    raise IncomparableError(
        f"{sweep.path} mixes what cannot be compared: {field} is {json.dumps(was)} in {first.job.name} and "
        f"{json.dumps(came)} in {second.job.name}. {_REMEDIES[kind]}"
    )
