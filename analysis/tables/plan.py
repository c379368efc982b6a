"""The tables of a plan: the ways that it weighed, and later what was planned beside what was done."""

from collections.abc import Iterable, Sequence

from analysis.rounding import shown
from analysis.statistics.planning import CONFIDENCE, MOST, TRIALS
from analysis.sweeps.plans import Planned, Way
from analysis.table import Cell, Percent, Table
from tacevo.storage.plan import Measure, SeedPlan
from tacevo.text import counted

#: What a value is, by the metric.
_VALUES = {Measure.mse: "test MSE", Measure.accuracy: "test accuracy", Measure.fitness: "best fitness"}


def plan_table(planned: Planned) -> Table:
    """Show what each way needs and costs."""
    pilot, wish, cells = planned.pilot, planned.wish, _cells(planned.ways[0], planned)
    value, scale = _VALUES[pilot.metric], "" if pilot.metric is Measure.accuracy else "the logarithm of a "
    return Table(
        name=f"plan_{pilot.kind}_{pilot.task}",
        caption=f"Seeds that find {_effect(pilot.metric, wish.effect)} with a chance of {shown(Percent(wish.power))} "
        f"({pilot.task}, {pilot.kind}).",
        columns=tuple(cells),
        rows=tuple(tuple(_cells(way, planned).values()) for way in planned.ways),
        notes=(
            f"Seeds: a number, found by halving, that finds the effect so often in {TRIALS:,} simulated cases, by "
            f"two-sided Mann-Whitney tests and Holm's correction over {wish.comparisons}, at alpha {wish.alpha:g}; of "
            f"the family one differs. At most {MOST} are tried.",
            f"Spread: the standard deviation of {scale}{value}, which is drawn from a normal distribution; of the "
            f"pilot, with {counted(pilot.spread.freedom, 'degree')} of freedom, or its upper limit, below which the "
            f"true one lies with a confidence of {shown(Percent(CONFIDENCE))}.",
            "Epochs: of all trainings. Hours: these epochs on one worker of the pilot's machine, as fast as the "
            "pilot's candidates were gated and trained; without the answers.",
            *_fitness_note(pilot.metric),
        ),
    )


def planned_table(task: str, plan: SeedPlan, done: Iterable[tuple[str, Cell, Cell]]) -> Table:
    """Show what was planned beside what was done: a name, the planned value and the one that came."""
    return Table(
        name="planned",
        caption=f"What was planned, and what was done ({task}).",
        columns=("what", "planned", "done"),
        rows=tuple(done),
        notes=(
            f"The plan was to find {_effect(plan.metric, plan.effect)} with a chance of {shown(Percent(plan.power))}, "
            f"from {counted(len(plan.pilots), 'pilot run')}; simulated {shown(Percent(plan.chance))}. With "
            "fewer seeds, more comparisons or a wider spread the chance was lower.",
            *([f"The plan was {plan.dated}, which proves nothing by itself."] if plan.made else []),
        ),
    )


def counts(numbers: Sequence[int]) -> Cell:
    """Show one number, or the least and the greatest of several."""
    found = sorted(numbers)
    return found[0] if found[0] == found[-1] else f"{found[0]} to {found[-1]}"


def _cells(way: Way, planned: Planned) -> dict[str, Cell]:
    """Return a row by the names of its columns; those of searches are a sweep's."""
    found, is_sweep = way.needed.seeds is not None, planned.pilot.kind == "sweep"
    return {
        "spread": way.spread,
        "it is": "the upper limit" if way.cautious else "the pilot's",
        **({"training seeds of a job": way.retraining} if is_sweep else {}),
        "seeds": way.needed.seeds if found else f"more than {MOST}",
        "chance": Percent(way.needed.chance),
        **({"searches": way.searches if found else None} if is_sweep else {}),
        "full trainings": way.trainings if found else None,
        "epochs": way.epochs if found else None,
        "hours": way.hours if found else None,
        "plan": "chosen" if way == planned.chosen else None,
    }


def _effect(metric: Measure, effect: float) -> str:
    """Write an effect: a part of an error, or points of an accuracy."""
    if metric is Measure.accuracy:
        return f"{shown(100 * effect)} percentage points of {_VALUES[metric]}"
    return f"{shown(Percent(effect))} less {_VALUES[metric]}"


def _fitness_note(metric: Measure) -> tuple[str, ...]:
    if metric is not Measure.fitness:
        return ()
    return (
        "The values are the best fitnesses of searches, since not every job of the pilot has a test score "
        "(tacevo study sweep=DIR); the primary metric of a sweep, a test score, may spread otherwise.",
    )
