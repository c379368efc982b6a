"""What a run or a sweep found, in short sentences: the first thing that its page says."""

from analysis.report.collection import Collection, Compared
from analysis.rounding import p_in_words, shown
from analysis.studies.comparison import Verdict, of_whole
from analysis.sweeps.ablation import Ablation
from analysis.sweeps.arm_metrics import LESS_IS_BETTER
from analysis.tables.dynamics import reestimated
from tacevo.results.grouped import images_tested
from tacevo.results.sweep import ALPHA
from tacevo.text import counted, listed


def found(collection: Collection) -> list[str]:
    """Say what a run found, a line for each: what is left of its record with other seeds, and what its studies say.

    Where nothing was found, that comes first. Sentences are short, with three numbers at most. No lines before anything
    was trained.
    """
    run = collection.run
    if not run.elites:
        return []
    best = run.ranked()[0]
    again = reestimated(run, collection.reestimates)
    if again is None:
        baseline = run.baseline.fitness
        beside = "" if baseline is None else f" The baseline has {shown(baseline)}."
        line = f"{best.id} has the lowest loss on record, {shown(best.fitness)}.{beside} Single draws, not repeated."
    else:
        _, reference, median = again
        line = (
            f"{best.id} is best on record, with a loss of {shown(best.fitness)}. "
            f"With other seeds it has {shown(median)}, and the baseline {shown(reference)}."
        )
    tested = [_tested(compared) for compared in collection.studies if compared.comparisons is not None]
    return [*([run.shortfall] if run.shortfall else []), line, *tested]


def _tested(compared: Compared) -> str:
    """Say how many networks of a study are better than its baseline, what of the others, and on what."""
    study, verdicts = compared.study, list(of_whole(compared.comparisons).verdict)
    networks, better = counted(len(verdicts), "network"), verdicts.count(Verdict.better)
    others = [f"{verdicts.count(verdict)} {verdict}" for verdict in Verdict if verdict in verdicts]
    rest = [words for words in others if not words.endswith(Verdict.better)]
    images = images_tested(study.data, "image") + (" of other data" if study.other_data else "")
    return (
        f"{better} of {networks} {'is' if better == 1 else 'are'} better than the baseline after "
        f"{counted(study.recipe.epochs, 'epoch')}. {f'The others: {listed(rest)}. ' if rest else ''}Tested on {images}."
    )


def found_in_sweep(ablation: Ablation) -> list[str]:
    """Say which arms differ from the reference in the first metric, a line for each; none without a reference."""
    if ablation.reference is None:
        return []
    metric, frame = ablation.first, ablation.arms[ablation.first]
    others = frame[frame.index != ablation.reference]
    tested = others[others.p_holm.notna()]
    told = [
        f"{arm} is {'better' if (difference < 0) == (metric in LESS_IS_BETTER) else 'worse'} "
        f"(p after Holm {p_in_words(p)})."
        for arm, difference, p in zip(tested.index, tested.difference, tested.p_holm, strict=True)
        if p <= ALPHA and difference
    ]
    if tested.empty:
        return [f"No arm could be tested against {ablation.reference} by {metric.value}."]
    verb = "are" if len(told) > 1 else "is"
    differ = f"By {metric.value}, {len(told) or 'none'} of {counted(len(tested), 'arm')} {verb} shown to differ from "
    return [f"{differ}{ablation.reference}.", *told]
