"""Alarms: what is wrong with a search whose figures may look fine, each with the figures behind it (docs/analysis.md).

An alarm is a hint, not a verdict; its threshold stands here with its reason.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.runs.coverage_map import AXES, CoverageMap, coverage_map, effective_niches, fullest_tenth, reachable
from analysis.runs.dynamics import by_prompt, mutations, progress, repeats
from tacevo.choices import BoundsRule, Carrier, Scale
from tacevo.evolution.lines import TEMPERATURE, gate_stages
from tacevo.results.run import RecordedRun, descriptors_of
from tacevo.text import counted

#: Below this part of reachable niches, coverage says more about the bounds than about the search: the paper's own runs
#: filled 88 % and 92 %.
REACHABLE = 0.5

#: Where a fifth of the candidates lies outside fixed bounds, niches at the border hold unlike networks.
CLIPPED = 0.2

#: A niche with half of all candidates is where the search took place; the others were visited.
CROWDED = 0.5

#: Moves of the bounds in the last half of a search are late: elites were compared under other niches until then.
LATE = 0.5

#: An axis whose middle nine tenths of candidates fill less than this of it hardly distinguishes any two of them.
NARROW = 0.05

_MIDDLE = (0.05, 0.95)

#: Where a tenth of an axis holds half of the candidates, the niches of its other nine tenths distinguish only the rest.
CONCENTRATED = 0.5

#: Every fourth answer brought what was known already; a quarter of the price is worth a word.
REPEATED = 0.25

#: The paper lost 4 % and 5.5 % of its candidates at the whole gate.
REJECTED = 0.2

#: In the published runs no training took more than 4.4 times the wall time that its operations explain. A training that
#: does more than it was asked to takes longer.
UNEXPLAINED = 5.0

#: The fewest trainings that show what is usual.
_USUAL = 5

#: Generations at a limit after which the temperature no longer counts as moving.
STUCK = 3


class Alarm(NamedTuple):
    """One thing that may be wrong."""

    #: The subject of the alarm, e.g. `few reachable niches`.
    name: str
    #: The finding and why it matters, for a person.
    sentence: str
    #: The figures behind it, by name.
    figures: Mapping[str, float]


def alarms(run: RecordedRun, centroids: NDArray[np.float64]) -> tuple[Alarm, ...]:
    """Look for everything that may be wrong: niches and descriptors first, then candidates, prompts and temperature.

    The centroids are those of the network archive, shape (niches, axes), in [0, 1]; not looked at where it has none.
    """
    raised: list[Alarm] = []
    if run.bounds is not None:
        placed = coverage_map(run, centroids)
        raised += _of_niches(placed, centroids)
        raised += _of_descriptors(run, placed)
    return (*raised, *_of_candidates(run), *_of_prompts(run), *_of_temperature(run))


def _of_niches(placed: CoverageMap, centroids: NDArray[np.float64]) -> Iterator[Alarm]:
    reached, total = len(reachable(placed, centroids)), len(centroids)
    if reached / total < REACHABLE:
        yield Alarm(
            name="few reachable niches",
            sentence=f"Only {reached} of {counted(total, 'niche')} lie where the run's networks lie or between them, "
            "so coverage cannot come near 100 %; a few unusual networks may stretch the bounds.",
            figures={"reachable": reached, "niches": total, "share": reached / total},
        )
    share = np.unique(placed.niches, return_counts=True)[1].max() / len(placed.niches)
    if share > CROWDED and len(placed.niches) > 1:
        yield Alarm(
            name="crowded niche",
            sentence=f"One niche drew {100 * share:.0f} % of the trained candidates; the archive keeps one network of "
            "them.",
            figures={"share": float(share), "effective niches": effective_niches(placed)},
        )


def _of_descriptors(run: RecordedRun, placed: CoverageMap) -> Iterator[Alarm]:
    if placed.clipped > CLIPPED:
        yield Alarm(
            name="clipped descriptors",
            sentence=f"{100 * placed.clipped:.0f} % of the trained candidates lie outside the fixed bounds and were "
            f"moved to their edge; widen {' or '.join(f'archive.{axis}_bounds' for axis in run.config.archive.axes)}.",
            figures={"share": placed.clipped},
        )
    last = run.generations[-1].generation
    late = [generation for generation in placed.moved if generation > LATE * last]
    if late:
        lost = int(progress(run).lost.sum())
        yield Alarm(
            name="late bounds",
            sentence=f"The bounds of the descriptors moved {counted(len(late), 'time')} in the last half of the run, "
            f"lastly in generation {late[-1]}; each time the archive was rebuilt. All moves of the run together "
            f"emptied {counted(lost, 'niche')}; archive.bounds=fixed loses none.",
            figures={"late moves": len(late), "moves": len(placed.moved), "last": late[-1], "lost niches": lost},
        )
    if len(placed.points) > 1:
        for axis, values in zip(run.config.archive.axes, placed.points.T, strict=True):
            yield from _of_axis(run, axis, values)


def _of_axis(run: RecordedRun, axis: str, values: NDArray[np.float64]) -> Iterator[Alarm]:
    """Look at how the candidates lie along an axis; `values`, shape (candidates,), are normalised."""
    name = AXES.get(axis, (axis, axis))[0]
    low, high = np.quantile(values, _MIDDLE)
    extent, share = float(high - low), fullest_tenth(values, (0.0, 1.0))
    if extent < NARROW:
        yield Alarm(
            name=f"constant {name}",
            sentence=f"Nine tenths of the trained candidates lie within {100 * extent:.1f} % of the range of "
            f"{name}, which therefore distinguishes few networks.",
            figures={"extent": extent},
        )
    if share > CONCENTRATED:
        remedy, figures = _remedy(run, axis)
        yield Alarm(
            name=f"concentrated {name}",
            sentence=f"{100 * share:.0f} % of the trained candidates lie in a tenth of the range of {name}, "
            f"where few niches distinguish them; {remedy}.",
            figures={"share": share, **figures},
        )


def _remedy(run: RecordedRun, axis: str) -> tuple[str, dict[str, float]]:
    """Return what would spread the candidates along an axis; for a logarithm, with the share that remains then."""
    settings = run.config.archive
    adaptive = settings.bounds is BoundsRule.adaptive  # a fixed lower bound of 0 has no logarithm
    if adaptive and axis == "eff_ratio" and settings.eff_ratio_scale is Scale.linear:
        logarithms = np.array([descriptors_of(candidate, Scale.log)[1] for candidate in run.trained])
        after = fullest_tenth(logarithms, (logarithms.min(), logarithms.max()))
        if after <= CONCENTRATED:
            words = f"under archive.eff_ratio_scale=log the fullest tenth would hold {100 * after:.0f} %"
            return words, {"share under log": after}
    if axis not in AXES:
        return "another axis would spread them", {}
    return f"archive.bounds=fixed with narrower archive.{axis}_bounds would spread them", {}


def _of_candidates(run: RecordedRun) -> Iterator[Alarm]:
    asked = run.answered
    known = (repeats(run) | run.copies) & {candidate.id for candidate in asked}
    if asked and len(known) / len(asked) > REPEATED:
        yield Alarm(
            name="many duplicates",
            sentence=f"{len(known)} of {counted(len(asked), 'answer')} brought a source that was evaluated before.",
            figures={"duplicates": len(known), "answers": len(asked), "share": len(known) / len(asked)},
        )
    for stage in gate_stages(run.candidates):
        share = stage.rejected / len(asked) if asked else 0.0
        if share > REJECTED:
            reason, count = stage.reasons[0]
            yield Alarm(
                name=f"strict gate: {stage.stage}",
                sentence=f"The stage {stage.stage} rejected {100 * share:.0f} % of all first answers, most often "
                f"for {reason} ({count}).",
                figures={"rejected": stage.rejected, "share": share},
            )
    yield from _of_time(run)


def _of_time(run: RecordedRun) -> Iterator[Alarm]:
    """Look for trainings that took far more processor time than the median of the run, and than their FLOPs explain."""
    flops = {one.id: (one.flops or 0) + one.extra_flops for one in run.trained}
    taken = {name: run.cpu_seconds[name] for name in flops if name in run.cpu_seconds}
    counted_flops = [name for name in taken if flops[name]]
    if len(counted_flops) < _USUAL:
        return
    usual = median(taken.values())
    of_flop = median(taken[name] / flops[name] for name in counted_flops)
    times = {name: seconds / max(usual, of_flop * flops[name]) for name, seconds in taken.items()}
    if many := {name: factor for name, factor in times.items() if factor > UNEXPLAINED}:
        worst = max(many, key=lambda name: many[name])
        others = f", and {counted(len(many) - 1, 'other')} more than {UNEXPLAINED:g} times" if len(many) > 1 else ""
        yield Alarm(
            name="unexplained processor time",
            sentence=f"The training of {worst} took {many[worst]:.0f} times the processor time that its operations "
            f"explain{others}: read what it does.",
            figures=dict(sorted(many.items())),
        )


def _of_prompts(run: RecordedRun) -> Iterator[Alarm]:
    """Look at instructions, unless the run ended before any mutation of generation 1."""
    prompts = by_prompt(run)
    if not prompts.tried.any():
        return
    drawn = {line.prompt for line in mutations(run)}
    untried = [name for index, name in enumerate(prompts.name) if index not in drawn]
    if untried:
        yield Alarm(
            name="untried prompts",
            sentence=f"Never drawn (prompts={run.config.prompts.policy}): {', '.join(untried)}.",
            figures={"untried": len(untried), "prompts": len(prompts)},
        )
    inserted, tried = int(prompts.inserted.sum()), int(prompts.tried.sum())
    for prompt in prompts.itertuples():
        others = inserted / (tried - prompt.tried) if tried > prompt.tried else 0.0
        # Without the interval, an instruction that was drawn twice would be blamed for bad luck.
        if not prompt.inserted and prompt.rate_high < others:
            yield Alarm(
                name="fruitless prompt",
                sentence=f"{prompt.name} was tried {prompt.tried} times, and no child of it entered the archive; "
                f"of all other instructions {100 * others:.0f} % of the children did.",
                figures={"tried": prompt.tried, "trained": prompt.trained, "others": others},
            )


def _of_temperature(run: RecordedRun) -> Iterator[Alarm]:
    if run.carrier is Carrier.none:
        return  # as the user wants it
    if TEMPERATURE in run.not_sent:
        missed = sum(TEMPERATURE in candidate.dropped for candidate in run.candidates)
        yield Alarm(
            name="temperature not sent",
            sentence=f"{run.not_sent[TEMPERATURE]}. The temperatures of generations and of the prompt archive are what "
            "was planned; they explain no answer.",
            figures={"requests": missed},
        )
        return
    if run.config.temperature.rule == "fixed":
        return
    for limit, count in Counter(line.temperature for line in run.generations if line.temperature in (0, 1)).items():
        if count >= STUCK and run.generations[-1].temperature == limit:
            yield Alarm(
                name="stuck temperature",
                sentence=f"The temperature ended at its limit of {limit:g} and was there for {count} generations"
                "; the paper's own rule can only raise it (docs/paper.md).",
                figures={"limit": limit, "generations": count},
            )
