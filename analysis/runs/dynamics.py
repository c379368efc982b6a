"""The course of a search, generation by generation: figures from its ledger, and nothing but counting.

A rate counts first answers, as the paper does: one that was rejected and then repaired counts as rejected.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import pandas as pd
from scipy.stats import binomtest

from analysis.statistics.effects import LEVEL
from tacevo.costs import Spending, total
from tacevo.evolution.archive import AddStatus
from tacevo.evolution.carriers import part_of
from tacevo.evolution.lines import CandidateLine, trained_networks, training_flops
from tacevo.evolution.models import gain_of
from tacevo.records import Operator, Stage
from tacevo.results.run import RecordedRun
from tacevo.rounding import DIGITS

#: The part of the whole improvement that counts as most of it.
MOST = 0.9

#: The generation by which the paper had most of its improvement (within the first 7 to 10 generations).
PUBLISHED_GENERATIONS = (7, 10)

#: Bands of equal width over the temperatures [0, 1]; one is as wide as the noise of a request's temperature is on
#: either side (docs/paper.md).
BANDS = 10


#: The columns that the ledger line of a generation gives; losses are missing before anything was trained.
_LINE = (
    {"temperature": "float64", "next_temperature": "float64", "candidates": "int64", "trained": "int64"}
    | dict.fromkeys(("repaired", "skipped"), "Int64")
    | dict.fromkeys(("best", "generation_best", "generation_median"), "float64")
    | dict.fromkeys(("coverage", "qd_score", "prompt_coverage"), "float64")
)

#: The columns of a frame of generations, whose index is `generation`, and the type of each. Beside its line: first
#: answers that were rejected, by stage; niches, or places, that are occupied after it; how many more these are than
#: before (below 0 where moved bounds made niches fall together); candidates that found their niche empty, and that beat
#: its elite; niches that emptied as bounds moved, less those that filled so; slots whose evaluation an earlier slot had
#: asked for, and whose network is a parent's (`copies`); what its answers cost, missing unless known of each.
GENERATIONS = (
    _LINE
    | {f"rejected_{stage}": "int64" for stage in Stage}
    | dict.fromkeys(("elites", "growth", "new", "improved", "lost", "repeated", "unchanged"), "int64")
    | dict.fromkeys(("answers", "tokens", "input_tokens", "output_tokens"), "Int64")
    | {"usd": "float64"}
)

#: The columns of a frame of mutations that have their instruction or temperature in common, and the type of each: slots
#: that were asked (a child that the gate rejected was tried, too, and inserted nowhere; a skipped one was not tried);
#: children that the network archive took, the sum of the paper's r(s); inserted / tried with Wilson's interval, missing
#: where nothing was tried.
PRODUCTIVITY = {"name": "str"} | dict.fromkeys(("tried", "trained", "inserted"), "int64")
PRODUCTIVITY |= dict.fromkeys(("rate", "rate_low", "rate_high"), "float64")

#: The columns of a frame of models, and the type of each: as those of `PRODUCTIVITY`, but of all slots that the model
#: was asked for; those that trained; the mean gain of all (`tacevo.evolution.models.gain_of`), by which a bandit
#: chooses; what its answers cost, missing unless known of each.
MODELS = (
    PRODUCTIVITY | {"gain": "float64"} | dict.fromkeys(("input_tokens", "output_tokens"), "Int64") | {"usd": "float64"}
)


def progress(run: RecordedRun) -> pd.DataFrame:
    """Return a row for each generation (`GENERATIONS`)."""
    repeated, unchanged = repeats(run), run.copies
    rows: list[dict[str, Any]] = []
    for line in run.generations:
        slots = [candidate for candidate in run.candidates if candidate.generation == line.generation]
        statuses = Counter(candidate.status for candidate in slots)
        stages = Counter(first[0] for slot in slots if (first := slot.first_rejection))
        elites = round(line.coverage * run.places)
        growth = elites - (rows[-1]["elites"] if rows else 0)
        row = {name: getattr(line, name) for name in _LINE}
        row |= {f"rejected_{stage}": stages[stage] for stage in Stage} | {"elites": elites, "growth": growth}
        row |= {"new": statuses[AddStatus.new], "improved": statuses[AddStatus.improved]}
        row |= {"lost": statuses[AddStatus.new] - growth}
        row |= {"repeated": sum(slot.id in repeated for slot in slots)}
        row |= {"unchanged": sum(slot.id in unchanged for slot in slots)}
        rows.append(row | _costs(spending(run, slots)))
    index = pd.Index([line.generation for line in run.generations], name="generation")
    return pd.DataFrame(rows, index=index, columns=list(GENERATIONS)).astype(GENERATIONS)


def _costs(spent: Spending | None) -> dict[str, int | float | None]:
    """Return the columns of a spending; tokens and dollars only where those of every answer are known."""
    if spent is None:
        return {}
    tokens = {} if spent.uncounted else {"input_tokens": spent.input_tokens, "output_tokens": spent.output_tokens}
    return {"answers": spent.answers, "tokens": spent.tokens, **tokens, "usd": None if spent.unpriced else spent.usd}


def repeats(run: RecordedRun) -> frozenset[str]:
    """Find the candidates whose evaluation an earlier slot had asked for, by id."""
    asked = [candidate for candidate in run.candidates if candidate.evaluation is not None]
    # The first that asked is the last to be put in.
    first = {candidate.evaluation: candidate.id for candidate in reversed(asked)}
    return frozenset(candidate.id for candidate in asked if first[candidate.evaluation] != candidate.id)


def by_prompt(run: RecordedRun) -> pd.DataFrame:
    """Return a row for each instruction of the library (`PRODUCTIVITY`), tried or not, in the library's order."""
    asked = mutations(run)
    return _productivity(
        (name, [candidate for candidate in asked if candidate.prompt == index])
        for index, name in enumerate(run.instructions)
    )


def by_model(run: RecordedRun) -> pd.DataFrame:
    """Return a row for each model of a search with several (`MODELS`), asked or not, in the user's order."""
    of = {name: [line for line in run.answered if line.model == name] for name in run.config.llm.names}
    rows = []
    for row, slots in zip(_productivity(of.items()).to_dict("records"), of.values(), strict=True):
        kept = [line for line in slots if not line.skipped]
        gains = [
            gain_of(line.fitness, (run.fitness[name] for name in line.parents or (run.baseline.id,))) for line in kept
        ]
        costs = _costs(spending(run, slots))
        mean = math.fsum(gains) / len(gains) if gains else None
        rows.append({**row, "gain": mean, **{key: costs.get(key) for key in ("input_tokens", "output_tokens", "usd")}})
    return pd.DataFrame(rows, columns=list(MODELS)).astype(MODELS)


def by_temperature(run: RecordedRun) -> pd.DataFrame:
    """Return a row for each band of the requests' temperatures in which something was asked, rising.

    Where words or effort carry them, a band is what one sentence or one effort stands for.
    """
    count = run.levels or BANDS
    bands: dict[int, list[CandidateLine]] = {}
    for candidate in mutations(run):
        if candidate.sent_temperature is not None:
            bands.setdefault(part_of(candidate.sent_temperature, count), []).append(candidate)
    return _productivity((_band(run, band, count, bands[band]), bands[band]) for band in sorted(bands))


def _band(run: RecordedRun, band: int, count: int, asked: Sequence[CandidateLine]) -> str:
    """Name a band of temperatures; with the sentence or the effort that it stands for, where it does."""
    low, high = band / count, (band + 1) / count
    if not run.levels:
        return f"{low:.1f}-{high:.1f}"
    return f"{asked[0].effort or f'sentence {band + 1}'}: {low:.2g}-{high:.2g}"


def temperature_follows_age(run: RecordedRun) -> bool:
    """Return whether T is a strictly monotone function of the generation, so that their effects cannot be separated.

    Generations that stand at a limit of 0 or 1, beyond which T cannot move, do not count against it.
    """
    temperatures = [line.temperature for line in run.generations if line.generation > 0]
    steps = [after - before for before, after in pairwise(temperatures) if after != before or after not in {0, 1}]
    return bool(steps) and (min(steps) > 0 or max(steps) < 0)


def improvement(run: RecordedRun) -> "pd.Series[Any]":
    """Measure how far a run came; fitness is a loss, so improvement is the part of it that is gone.

    Returns:
        By name; empty where it lacks a trained baseline, as no fold of a search does. Losses: `baseline`; `first`, the
        best of generation 0; `last`, the best of the last generation. Parts of the
        first two that are gone at the end, 0 where they are 0 already: `over_first`, `over_baseline`. `settled`: the
        first generation from which on it had `MOST` of the whole improvement over `first`; None without any. `by_7`,
        `by_10`: the part of it that each of `PUBLISHED_GENERATIONS` brought, as far as the run reached it. `trainable`:
        mean of the trainable share over generations 1 to G; None where there is generation 0 only. `coverage`: the
        occupied part of the niches at the end. `new_quartile`, `new_median`: fitness of the new candidates.
    """
    bests = [(line.generation, line.best) for line in run.generations if line.best is not None]
    baseline = run.baseline.fitness
    if baseline is None or not bests:
        return pd.Series(dtype="object")
    first, last = bests[0][1], bests[-1][1]
    gained = {generation: (first - best) / (first - last) for generation, best in bests if first > last}
    before = max((generation for generation, share in gained.items() if share < MOST), default=-1)
    later = [line for line in run.generations if line.generation > 0]
    facts = {
        **{"baseline": baseline, "first": first, "last": last},
        "over_first": (first - last) / first if first else 0.0,
        "over_baseline": (baseline - last) / baseline if baseline else 0.0,
        "settled": next((generation for generation in gained if generation > before), None),
        **{f"by_{number}": gained[number] for number in PUBLISHED_GENERATIONS if number in gained},
        "trainable": sum(line.trainable for line in later) / len(later) if later else None,
        "coverage": run.generations[-1].coverage,
        **_new_candidates(run),
    }
    return pd.Series(facts, dtype="object")


def _new_candidates(run: RecordedRun) -> dict[str, float | None]:
    """Return the fitness that a quarter, and a half, of the new candidates of the later generations reach.

    Each is a draw of its own of a network whose parents were chosen by earlier draws, so luck does not pile up in it as
    it does in the best of many. New is a source that no slot had before; later are the generations after G / 2. A slot
    that gave nothing that trains is worse than any fitness: None where so many of them are. A skipped one is left out.
    """
    first = {line.source: line for line in reversed(run.candidates) if line.source is not None}
    later = [line for line in run.candidates if 2 * line.generation > run.generations[-1].generation]
    new = [line for line in later if line.source is None or (first[line.source] is line and not line.skipped)]
    ranked = sorted(math.inf if line.fitness is None else line.fitness for line in new)
    reached = (
        {"new_quartile": ranked[(len(ranked) - 1) // 4], "new_median": ranked[(len(ranked) - 1) // 2]} if ranked else {}
    )
    return {name: fitness if math.isfinite(fitness) else None for name, fitness in reached.items()}


def mutations(run: RecordedRun) -> list[CandidateLine]:
    """Return the mutations that count for a prompt: not those of generation 0, which fill an empty archive."""
    return [
        candidate
        for candidate in run.candidates
        if candidate.operator is Operator.mutation and candidate.generation > 0 and candidate.prompt is not None
    ]


def _productivity(asked: Iterable[tuple[str, Sequence[CandidateLine]]]) -> pd.DataFrame:
    rows = []
    for name, all_slots in asked:
        slots = [one for one in all_slots if not one.skipped]  # of which nobody knows what they would have brought
        inserted, ends = sum(one.inserted for one in slots), {}
        if slots:
            wilson = binomtest(inserted, len(slots)).proportion_ci(LEVEL, method="wilson")  # the score interval of 1927
            low, high = (round(float(end), DIGITS) for end in wilson)
            ends = {"rate": inserted / len(slots), "rate_low": low, "rate_high": high}
        trained = sum(one.fitness is not None for one in slots)
        rows.append({"name": name, "tried": len(slots), "trained": trained, "inserted": inserted, **ends})
    return pd.DataFrame(rows, columns=list(PRODUCTIVITY)).astype(PRODUCTIVITY)


def spent_on_training(run: RecordedRun) -> int:
    """Return the FLOPs of a search's trainings, as its budget counts them."""
    trained = trained_networks(run.trained)
    images, epochs = run.facts.counts[0], run.config.training.epochs
    return training_flops(trained, images=images, epochs=epochs)


def spending(run: RecordedRun, slots: Iterable[CandidateLine]) -> Spending | None:
    """Add up what the answers of some slots cost; None where one is unknown, because a sum with gaps would mislead."""
    asked = [candidate.id for candidate in slots if candidate.request is not None]
    known = [run.spent[name] for name in asked if name in run.spent]
    return total(known) if len(known) == len(asked) else None
