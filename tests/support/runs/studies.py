"""Small studies, made by hand for the tests of the analysis."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import fmean

from hand_runs import FACTS
from ledger_lines import RECIPE, TERMS
from ledger_lines import score as line_of

from analysis.studies.reestimates import Reestimates
from analysis.table import Table
from tacevo.choices import Device, Numerics
from tacevo.records import Kind
from tacevo.results.study import RecordedStudy
from tacevo.results.study_lines import ScoreLine, StudyNetwork


def around(median: float, *, step: float, seeds: int = 20) -> list[float]:
    """Make seeds that lie evenly around a median, no two alike."""
    return [round(median + step * (at - (seeds - 1) / 2), 9) for at in range(seeds)]


#: A variant of each verdict: far below, far above, as good as equal, and too wide to tell.
FOUR = {
    "baseline": around(0.01, step=0.0001),
    "variant 1": around(0.007, step=0.0001),
    "variant 2": around(0.01301, step=0.0001),
    "variant 3": around(0.010003, step=0.00009),
    "variant 4": around(0.0101, step=0.00077),
}


def study_of(values: Mapping[str, Sequence[float]], *, kind: Kind = Kind.regression, seeds: int = 0) -> RecordedStudy:
    """Make a study from each network's primary metric, in the order of the seeds; 0 seeds are the first's."""
    metric = "mse" if kind is Kind.regression else "accuracy"
    return RecordedStudy(
        run="0" * 64,
        task="force" if kind is Kind.regression else "grating",
        seed=0,
        data=replace(FACTS, kind=kind, names=("Fx", "Fy", "Fz"), fingerprint="f" * 64),
        device=Device.cpu,
        units=("N", "N", "N") if kind is Kind.regression else (),
        recipe=RECIPE,
        numerics=Numerics.portable,
        scale=(),
        terms=TERMS[kind],
        seeds=seeds or len(next(iter(values.values()))),
        networks=tuple(network(name) for name in values),
        scores=tuple(
            score(name, seed, {metric: value}) for name, sample in values.items() for seed, value in enumerate(sample)
        ),
    )


def study_of_outputs(values: Mapping[str, Mapping[str, Sequence[float]]]) -> RecordedStudy:
    """Make a regression of several outputs from each one's error, by output and network; the whole's is their mean."""
    names = tuple(values)
    networks = list(values[names[0]])
    means = {
        name: [fmean(each) for each in zip(*(values[output][name] for output in names), strict=True)]
        for name in networks
    }
    study = study_of(means)
    apart = [
        replace(one, metrics={**one.metrics, **{f"mse_{name}": values[name][one.network][one.seed] for name in names}})
        for one in study.scores
    ]
    return replace(study, data=replace(study.data, names=names), units=("N",) * len(names), scores=tuple(apart))


def network(name: str) -> StudyNetwork:
    """Make a network of a name."""
    return StudyNetwork(name=name, id="g00s00", source=name, fitness=0.1, parameters=1000, flops=2000)


def score(name: str, seed: int, metrics: Mapping[str, float]) -> ScoreLine:
    """Make a network's score under a seed; of a classification with a matrix of three classes."""
    confusion = ((2, 1, 0), (0, 3, 0), (1, 0, 2)) if "accuracy" in metrics else None
    return replace(
        line_of(name, seed, 0.0),
        id=name,
        evaluation=f"{name}, {seed}",
        epoch=40,
        validation_loss=0.0,
        metrics=dict(metrics),
        confusion=confusion,
    )


def estimated(names: list[str], estimates: list[list[float]]) -> Reestimates:
    """Make re-estimates of networks whose recorded fitness was 0.1 each."""
    return Reestimates(
        name="noise",
        networks=tuple(replace(network(name), id=f"id of {name}") for name in names),
        estimates=tuple(map(tuple, estimates)),
        epochs=5,
    )


#: Losses of a baseline with a record of 0.5, and of a winner whose record is the lowest of all: 0.4, which no other
#: seed gives.
LOSSES = ((0.6, 0.5, 0.7), (0.7, 0.8, 0.9))


def reestimates(
    losses: Sequence[Sequence[float]] = LOSSES, *, name: str = "noise1-seeds3-epochs5-00000000"
) -> Reestimates:
    """Make the re-estimates of a baseline and a winner."""
    networks = (
        replace(network("baseline"), fitness=0.5),
        replace(network("variant 1"), id="g01s00", fitness=0.4),
    )
    estimates = tuple(map(tuple, losses))
    return Reestimates(name=name, networks=networks[: len(losses)], estimates=estimates, epochs=5)


def in_text(table: Table) -> str:
    """Write a table down for a golden file: every cell as Python has it, so nothing is rounded away."""
    rows = [" | ".join(str(cell) for cell in row) for row in (table.columns, *table.rows)]
    return "\n".join([f"{table.name}: {table.caption}", *rows, *(f"* {note}" for note in table.notes)]) + "\n"
