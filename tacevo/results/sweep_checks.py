"""Check that the runs of a sweep can be compared: equal data, budget and versions, and one configuration for each arm.

Arms differ in how they search. What decides how good a network looks, or how many a search may try, must be the same
in all of them, or a difference between two arms would be one of data, of budget or of software.
"""

import json
from collections.abc import Callable

from tacevo.choices import Carrier
from tacevo.errors import IncomparableError
from tacevo.evolution.lines import TEMPERATURE
from tacevo.evolution.run_files import rules_in_words
from tacevo.records import Json, to_json
from tacevo.results.sweep import FinishedJob, RecordedSweep
from tacevo.storage.canonical import canonical, differences, shown, value_at

#: Python and the packages that can change a request, a verdict of the gate, a niche or a fitness. The others compose
#: settings, deliver answers that are recorded, or track results.
VERSIONS = ("python", "tacevo", "torch", "numpy", "scipy", "scikit-learn", "pillow")

#: Settings in which two archives of the same kind may differ.
_SIZES = ("niches", "prompt_niches", "samples", "seed")

#: Settings of where and how a run is computed and tracked, and those that its data's fingerprint covers.
_INDIFFERENT = frozenset(["seed", "run", "store", "tracking", "executor", "sandbox", "data"])

_INDIFFERENT_LLM = frozenset(["mode", "base_url", "concurrency", "delivery", "budget_usd", "prices"])

_REMEDIES = {
    "data": "search on the same data in all jobs, with the same baseline",
    "budget": "use one budget in all jobs, and another sweep for another budget",
    "versions": "delete the directories of the older jobs, and repeat the command that began the sweep with another "
    "store.root, because what the old stores hold is not computed again",
    "archive": "use the same niches in all archives of one kind, and another sweep for other niches",
    TEMPERATURE: "delete the directories of such arms to compare the others; these need what carries "
    "temperatures to the model (temperature.carrier)",
    "arm": "delete the directory that does not belong to the arm, whose runs may differ in their seed only",
}


def check_sweep(sweep: RecordedSweep) -> None:
    """Check that the finished jobs of a sweep can be compared.

    Raises:
        IncomparableError: two jobs differ in their data, budget, rules or versions, or in the niches of archives that
            are otherwise alike, or two runs of an arm in more than their seed, or jobs in temperatures that the model
            refuses; the message names the jobs, the field and both values. Where the data follow from the seed, those
            of one seed are compared.
    """
    of_carriers: dict[Carrier, FinishedJob] = {}
    for other in sweep.finished:
        _check_temperatures(sweep, sweep.finished[0], other)
        _check_temperatures(sweep, of_carriers.setdefault(other.run.carrier, other), other)
    _compare_with_first(sweep, lambda one: "", _terms)
    _compare_with_first(sweep, lambda one: str(one.job.seed) if sweep.terms.vary else "", _data)
    _compare_with_first(sweep, _kind_of_archive, _niches)
    _compare_with_first(sweep, lambda one: one.job.arm, lambda one: {"arm": arm_settings(one)})


def _check_temperatures(sweep: RecordedSweep, one: FinishedJob, two: FinishedJob) -> None:
    """Check that two jobs do not differ in temperatures that never reached the model of one, or of both.

    Where it was chosen that nothing carries them, a job is compared with those whose temperatures are carried.
    """
    nominal = [job for job in (one, two) if job.run.carrier is Carrier.none]
    refused = [job for job in (one, two) if TEMPERATURE in job.run.not_sent and job not in nominal]
    if one.run.config.temperature != two.run.config.temperature and (refused or len(nominal) == 2):
        idle = (refused or nominal)[0]
        why = f"the model of {idle.job.name} refuses temperatures" if refused else "nothing carries them"
        raise IncomparableError(
            f"different ones in {one.job.name} and {two.job.name}, and in {idle.job.name} "
            f"{idle.run.not_sent[TEMPERATURE]}",
            place=f"{sweep.path}, {TEMPERATURE}",
            expected=f"equal temperatures, because {why}",
            remedy=_REMEDIES[TEMPERATURE],
        )


#: The settings of how long a candidate trains, and on which device.
_TRAINING = (
    *("epochs", "batch_size", "learning_rate", "seconds", "memory_mib"),
    *("device", "gpu", "precision", "gpu_memory_mib", "layout", "captured"),
)


def _terms(one: FinishedJob) -> dict[str, Json]:
    """Return what must be equal in all jobs, by what it belongs to and by its name."""
    run, config = one.run, one.run.config
    search, bound = config.search, config.search.training_flops
    data = {
        "task.name": run.task,
        "task.loss": config.task.loss,
        "hash of the baseline's source": run.baseline.source,
    }
    budget = {
        "number of generations": run.generations[-1].generation if bound is None else search.generations,
        "search.training_flops": bound,
        "search.candidates": search.candidates,
        "search.initial": search.initial,
        **{f"training.{key}": getattr(config.training, key) for key in _TRAINING},
    }
    versions = {
        "rules": rules_in_words(run.rules),
        "numerics.kind": config.numerics.kind,
        **{f"version of {name}": run.record.versions.get(name) for name in VERSIONS},
    }
    return {"data": data, "budget": budget, "versions": versions}


def _data(one: FinishedJob) -> dict[str, Json]:
    return {"data": {"fingerprint of the data": one.run.facts.fingerprint}}


def _niches(one: FinishedJob) -> dict[str, Json]:
    """Return what decides the niches of networks."""
    return {
        "archive": {f"archive.{key}": getattr(one.run.config.archive, key) for key in ("niches", "samples", "seed")}
    }


def _kind_of_archive(one: FinishedJob) -> str:
    return canonical({key: value for key, value in to_json(one.run.config.archive).items() if key not in _SIZES})


def arm_settings(one: FinishedJob) -> dict[str, Json]:
    """Return the settings that must be those of the whole arm."""
    config = {key: value for key, value in to_json(one.run.config).items() if key not in _INDIFFERENT}
    llm = {key: value for key, value in to_json(one.run.config.llm).items() if key not in _INDIFFERENT_LLM}
    return {**config, "llm": llm}


def _compare_with_first(
    sweep: RecordedSweep, group_of: Callable[[FinishedJob], str], fields_of: Callable[[FinishedJob], dict[str, Json]]
) -> None:
    """Compare the fields of each job, by what they belong to, with those of the first one of its group."""
    firsts: dict[str, FinishedJob] = {}
    for other in sweep.finished:
        first = firsts.setdefault(group_of(other), other)
        one, two = fields_of(first), fields_of(other)
        for field in differences(one, two)[:1]:
            was, came = (json.dumps(value_at(each, field)) for each in (one, two))
            raise IncomparableError(
                f"{was} in {first.job.name} and {came} in {other.job.name}",
                place=f"{sweep.path}, {shown(field[1:])}",
                expected="the same in all jobs that are compared",
                remedy=_REMEDIES[str(field[0])],
            )
