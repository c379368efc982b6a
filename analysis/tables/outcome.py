"""What a study found, on one screen: one table, and in a line each what to beware of."""

from dataclasses import astuple

import pandas as pd

from analysis.rounding import shown
from analysis.statistics.effects import LEVEL, median, median_confidence
from analysis.studies.comparison import late, of_whole
from analysis.studies.metric_names import SHARES, metric_name
from analysis.studies.reestimates import Reestimates
from analysis.studies.warnings import Caution, caution_notes
from analysis.table import Cell, Percent, PercentInterval, Table
from analysis.tables.choice import chosen_note
from analysis.tables.comparison import score_cell, verdict_in_words
from tacevo.results.grouped import images_tested
from tacevo.results.study import RecordedStudy
from tacevo.results.study_lines import StudyNetwork
from tacevo.results.trivial import at_chance, trivial_score
from tacevo.text import counted

_ONE_SPLIT = "One split of one data set: another split, or other data, may turn a verdict."

_AT_CEILING = "At the ceiling: next to nothing is left to win over the baseline on these data (tables)."


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
            *chosen_note(study),
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


def _score(study: RecordedStudy, network: str) -> Cell:
    """Return the median test score of a network with its interval; of one seed, its score."""
    values = study.values(network, study.primary)
    if len(values) == 1:
        return score_cell(study.primary, float(values[0]))
    middle = median(values)
    return PercentInterval(*astuple(middle)) if study.primary in SHARES else middle


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
