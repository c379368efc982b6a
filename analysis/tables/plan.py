"""The table of a plan, with the ways that it weighed."""

from analysis.rounding import shown
from analysis.statistics.planning import CONFIDENCE, MOST, TRIALS
from analysis.sweeps.pilots import Pilot
from analysis.sweeps.plans import Planned
from analysis.table import Percent, Table
from analysis.tables.followed_plan import VALUES, effect_in_words
from tacevo.storage.plan_file import Measure
from tacevo.text import counted

_BY_FITNESS = (
    "The values are the best fitnesses of searches, since not every job of the pilot has a test score "
    "(tacevo study sweep=DIR); the primary metric of a sweep, a test score, may spread otherwise."
)


_CHOICE = (
    "The tested network of each job is chosen among {elites} by one training of each, and of the baseline: full "
    "trainings count these, too."
)


def plan_table(planned: Planned) -> Table:
    """Show what each way needs and costs."""
    pilot, wish = planned.pilot, planned.wish
    value, scale = VALUES[pilot.metric], "" if pilot.metric is Measure.accuracy else "the logarithm of a "
    ways = planned.ways.assign(
        needed=planned.ways.seeds.astype("object").fillna(f"more than {MOST}"),
        plan=["chosen" if row == planned.chosen else None for row in planned.ways.index],
    )
    return Table.of(
        ways,
        {
            **({"between searches": "between"} if pilot.kind == "sweep" else {}),
            "spread": "spread",
            **({"training seeds of a job": "retraining"} if pilot.kind == "sweep" else {}),
            "seeds": "needed",
            "chance": (Percent, "chance"),
            **({"searches": "searches"} if pilot.kind == "sweep" else {}),
            **{"full trainings": "trainings", "epochs": "epochs", "hours": "hours", "plan": "plan"},
        },
        name=f"plan_{pilot.kind}_{pilot.task}",
        caption=f"Seeds that find {effect_in_words(pilot.metric, wish.effect)} with a chance of "
        f"{shown(Percent(wish.power))} ({pilot.task}, {pilot.kind}).",
        notes=(
            f"Seeds: a number, found by halving, that finds the effect so often in {TRIALS:,} simulated cases, by "
            f"two-sided Mann-Whitney tests and Holm's correction over {wish.comparisons}, at alpha {wish.alpha:g}; of "
            f"the family one differs. At most {MOST} are tried.",
            f"Spread: the standard deviation of {scale}{value}, which is drawn from a normal distribution; the upper "
            f"limit of the pilot's, {shown(pilot.spread.deviation)} with {counted(pilot.spread.freedom, 'degree')} of "
            f"freedom, below which the true one lies with a confidence of {shown(Percent(CONFIDENCE))}.",
            *([f"Tested: {pilot.elites} networks of each job, so often each."] if pilot.elites > 1 else []),
            *([_CHOICE.format(elites=counted(pilot.validated, "elite"))] if pilot.validated else []),
            *_between_note(pilot),
            "Epochs: of all trainings. Hours: these epochs on one worker of the pilot's machine, as fast as the "
            "pilot's candidates were gated and trained; without the answers.",
            *([_BY_FITNESS] if pilot.metric is Measure.fitness else []),
        ),
    )


def _between_note(pilot: Pilot) -> tuple[str, ...]:
    """Say what of a sweep's spread lies between its searches, and how little a small pilot knows of it."""
    if pilot.kind == "study":
        return ()
    between = "Interval searches: all of the spread, since the pilot has no second training of a job."
    if pilot.tested:
        between = (
            f"Interval searches: what is left of the spread without {shown(pilot.tested)}, the noise of trainings."
        )
    if pilot.is_all_noise:
        between += (
            " That noise alone explains the pilot's spread, so by the pilot all searches might be equal; the plan does "
            "not count on it. A pilot of more jobs, or of more training seeds a job, would say more."
        )
    low, high = pilot.spread.interval
    return (f"{between} By the pilot alone, its spread may be {shown(low)} to {shown(high)} (95 % interval).",)
