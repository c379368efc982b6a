"""What a study or a noise run found, on one screen: one table, and in a line each what to beware of."""

from dataclasses import astuple

import pandas as pd

from analysis.rounding import shown
from analysis.statistics.effects import LEVEL, median, median_confidence, superiority
from analysis.studies.comparison import late, of_whole
from analysis.studies.metric_names import SHARES, metric_name
from analysis.studies.reestimates import Reestimates
from analysis.studies.warnings import Caution, caution_notes
from analysis.table import Cell, Percent, PercentBetween, Table
from analysis.tables.comparison import score_cell, verdict_in_words
from analysis.tables.noise import BEATS, chance_note
from tacevo.results.grouped import images_tested
from tacevo.results.study import RecordedStudy
from tacevo.results.study_lines import StudyNetwork
from tacevo.results.trivial import at_chance, trivial_score
from tacevo.text import counted, listed

#: How many networks of a noise run are listed: the baseline, the best on record, and the best of the re-estimates.
MOST = 10

_ONE_SPLIT = "One split of one data set: another split, or other data, may turn a verdict."

_AT_CEILING = "At the ceiling: next to nothing is left to win over the baseline on these data (tables)."

_TOGETHER = (
    f"Better and worse: by intervals that hold for all elites together with {100 * LEVEL:g} %, and so are wider than "
    "those of the table."
)


def study_outcome(
    study: RecordedStudy,
    comparisons: pd.DataFrame | None,
    again: Reestimates | None,
    *,
    is_alone: bool,
    trivial: float | None,
) -> Table:
    """Show what a study found.

    Args:
        study: what was tested.
        comparisons: the comparisons; None where there are none.
        again: the re-estimates of the recorded fitnesses; None where the study gives none.
        is_alone: whether its networks were studied on these data only.
        trivial: the trivial loss of the run's validation images; None where it is not known.
    """
    rows = [_row(study, network, comparisons, again) for network in study.networks]
    names = {
        "test": f"test {metric_name(study.primary)}{_ends(study.seeds)}",
        "fitness": "fitness, one draw",
        "verdict": "verdict (p)",
        "again": "re-estimated",
    }
    variants, few = of_whole(comparisons), Caution.few_seeds
    cautions = dict(zip(variants.network, variants.cautions, strict=True))
    score = trivial_score(study)
    if score is not None:
        test = score_cell(study.primary, score)
        rows.append({**dict.fromkeys(rows[0]), "network": "trivial", "test": test, "fitness": trivial})
    other = ", whose groups are not recorded" if study.lacks_groups else ""
    other += f", on {study.where}" if study.where else ""
    other += f", trained with {study.trained_with}" if study.trained_with else ""
    return Table(
        name="outcome",
        caption=f"{study.task}: {counted(study.seeds, 'training seed')}, "
        f"{counted(study.recipe.epochs, 'epoch')}, tested on {images_tested(study.data, 'image')}{other}"
        + ("" if comparisons is None else "; verdicts against the baseline, p after Holm"),
        columns=tuple(names.get(column, column) for column in rows[0]),
        rows=tuple(tuple(row.values()) for row in rows),
        notes=(
            *at_chance(study),
            *([_AT_CEILING] if any(Caution.ceiling in told for told in cautions.values()) else []),
            *_late(study, comparisons),
            *caution_notes((name, [few]) for name, told in cautions.items() if few in told),
            *([_ONE_SPLIT] if is_alone else []),
            _fitness(again),
            *([f"Elites chosen by the noise run with the digest {study.chosen_by[:12]}."] if study.chosen_by else []),
        ),
    )


def _row(
    study: RecordedStudy, network: StudyNetwork, comparisons: pd.DataFrame | None, again: Reestimates | None
) -> dict[str, Cell]:
    cells: dict[str, Cell] = {"network": network.name, "id": network.id, "test": _score(study, network.name)}
    if comparisons is not None:
        variants = of_whole(comparisons).itertuples()
        verdicts = {one.network: verdict_in_words(study, one) for one in variants}
        cells["verdict"] = verdicts.get(network.name)
    cells["fitness"] = network.fitness
    if again is not None:
        cells["again"] = again.median_of(network.id)
    return cells


def noise_outcome(again: Reestimates, task: str, trivial: float | None) -> Table:
    """Show what a noise run found: the recorded fitness of its networks beside what other seeds give.

    `trivial` is the trivial loss, where it is known; it has the last row.

    It begins with the finding in one sentence (`_finding`), unless the baseline was trained again alone.
    """
    known = again.noise
    best = known[2:].sort_values("median", kind="stable").index[: MOST - 2]
    listed_ones = known.loc[[*known.index[:2], *sorted(best)]]
    seeds = counted(again.seeds, "other seed")
    how = "looked up in its table" if again.looked_up else "trained again as the search did,"
    trained = f"{task}: {counted(len(known), 'network')}, {how} with {seeds}"
    finding = _finding(again)
    return Table.of(
        listed_ones,
        {"network": "network", "id": "candidate", "fitness, one draw": "recorded", "re-estimated": "median"}
        | {"least": "least", "most": "most", f"chance to beat the baseline [{100 * LEVEL:g} %]": BEATS},
        name="outcome",
        caption=trained if finding is None else finding,
        last=() if trivial is None else (("trivial", None, trivial, trivial, None, None, None),),
        notes=(
            *chance_note(again, trivial),
            *(() if finding is None else (f"{trained}.",)),
            *((_TOGETHER,) if len(known) > 2 else ()),
            *_undecidable(again),
            *_left_out(again, len(known) - len(listed_ones)),
            "Re-estimated: the median of these seeds. The lowest of many flatters its network too, if less.",
            _icc(again),
        ),
    )


def _finding(again: Reestimates) -> str | None:
    """Say how many networks are better than the baseline, which, and how many are not.

    That rests on the intervals of their chances to beat it, widened so that they hold for all of them together
    (Bonferroni).

    Returns:
        None where no other network than the baseline was trained with every seed.
    """
    baseline, *others = again.estimates
    if not others:
        return None
    chances = [superiority(values, baseline, level=_level(len(others))) for values in others]
    ranked = again.noise[1:].assign(low=[chance.low for chance in chances]).sort_values("median", kind="stable")
    better = [f"{one.candidate} ({shown(one.median)})" for one in ranked[ranked.low > 0.5].itertuples()]
    worse = sum(chance.high < 0.5 for chance in chances)
    rest = [
        f"{count} {words}"
        for count, words in ((len(others) - len(better) - worse, "cannot be told from it"), (worse, "worse"))
        if count
    ]
    named = f": {listed(better, most=MOST)}" if better else ""
    trained = " that trained with every seed" if again.failed else ""
    return (
        f"Of {counted(len(others), 'elite')}, the best on record{trained}, {len(better) or 'none'} can be called "
        f"better than the baseline, whose loss is {shown(float(again.noise['median'].iloc[0]))}{named}"
        f"{''.join(f'; {one}' for one in rest)} (medians of {counted(again.seeds, 'other seed')})."
    )


def _level(others: int) -> float:
    """Return the level of each interval at which so many hold together (Bonferroni)."""
    return 1 - (1 - LEVEL) / others


def _undecidable(again: Reestimates) -> tuple[str, ...]:
    """Say where so few seeds could not tell any of so many networks from the baseline."""
    seeds, others = again.seeds, len(again.networks) - 1
    if others < 1 or _can_tell(seeds, others):
        return ()
    ways = [*([] if again.looked_up else ["more seeds="]), *(["fewer elites="] if _can_tell(seeds, 1) else [])]
    advice = f": take {' or '.join(ways)}" if ways else ""
    return (
        f"{counted(seeds, 'seed')} cannot tell any of {counted(others, 'network')} from the baseline, however far "
        f"apart they are{advice}.",
    )


def _can_tell(seeds: int, others: int) -> bool:
    """Answer whether so many seeds can tell one of so many networks from the baseline, if it is far enough apart."""
    return superiority([0] * seeds, [1] * seeds, level=_level(others)).low > 0.5


def _score(study: RecordedStudy, network: str) -> Cell:
    """Return the median test score of a network with its interval; of one seed, its score."""
    values = study.values(network, study.primary)
    if len(values) == 1:
        return score_cell(study.primary, float(values[0]))
    middle = median(values)
    return PercentBetween(*astuple(middle)) if study.primary in SHARES else middle


def _ends(seeds: int) -> str:
    if seeds == 1:
        return ""
    return f" [{100 * LEVEL:g} %]" if median_confidence(seeds) >= LEVEL else " [least, most]"


def _late(study: RecordedStudy, comparisons: pd.DataFrame | None) -> tuple[str, ...]:
    parts = late(study)
    if comparisons is None or not any(parts.values()):
        return ()
    most = max(parts, key=lambda name: parts[name])
    return (
        f"Not converged? {shown(Percent(parts[most]))} of the seeds of {most} are best in the last tenth of epochs: "
        "better may only mean faster.",
    )


def _fitness(again: Reestimates | None) -> str:
    if again is None:
        return "The fitness is not re-estimated here; tacevo noise RUN does that, and tacevo show RUN prints it."
    seeds = counted(again.seeds, "other seed")
    return f"Fitness: {again.fitness}; the record is one draw, the re-estimate a median of {seeds}."


def _left_out(again: Reestimates, unlisted: int) -> tuple[str, ...]:
    failed = listed(one.name for one in again.failed)
    return (
        *([f"Not listed: {unlisted} with a higher re-estimate; the tables have all."] if unlisted else []),
        *([f"Left out, because a training failed: {failed}."] if again.failed else []),
    )


def _icc(again: Reestimates) -> str:
    icc = again.icc
    if icc is None:
        return "No ICC: it takes two networks, two seeds, and losses above 0 that differ."
    part = f"{shown(icc)} ({100 * LEVEL:g} % interval)"
    return f"ICC {part}: the part of one fitness's variance that is the network's; the rest is the seed's."
