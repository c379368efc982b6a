"""The tables of arms that are compared answer by answer."""

from collections.abc import Mapping, Sequence

from analysis.sweeps.pairs import GENERATION, LEAST, Pairs
from analysis.table import Layout, PValue, Table, interval_cell, percent
from tacevo.text import counted, listed


def pairs_tables(pairs: Pairs, name: str) -> Sequence[Table]:
    """Make the table of losses, and that of how diverse the answers are where questions were asked several times."""
    tables = [_losses(pairs, name)]
    return tables if pairs.diversity is None else [*tables, _diversity(pairs, name)]


def _losses(pairs: Pairs, name: str) -> Table:
    parents = "instruction and seed, and other parents at the same places"
    same = parents if pairs.other_parents else "parents, instruction and seed"
    asked = "the same instructions for other parents" if pairs.other_parents else "the same questions"
    frame = pairs.arms.assign(arm=pairs.arms.index, is_reference=pairs.arms.index == pairs.reference)
    lengths: Layout = {
        f"{words} of {what}": (_whole, f"{way}_{unit}")
        for what, way in (("request", "input"), ("answer", "output"))
        for unit, words in (("characters", "characters"), ("tokens", "tokens"))
        if frame[f"{way}_{unit}"].notna().any()
    }
    return Table.of(
        frame,
        {
            "arm": "arm",
            "pairs": "pairs",
            "questions": (_questions, "is_reference", "questions"),
            "loss, factor": (interval_cell, "factor", "factor_low", "factor_high"),
            "p": (PValue, "p"),
            "p, Holm": (PValue, "p_holm"),
            "SD of a question": "deviation",
            "trained": (percent, "trained"),
            "p, trained": (PValue, "trained_p"),
            "p, Holm, trained": (PValue, "trained_p_holm"),
            **lengths,
        },
        name="pairs",
        caption=f"Answers of {name} to {asked}, against those of {pairs.reference}.",
        notes=(
            f"A pair: the answers of two arms to one question in generation {GENERATION}, with the same {same}. "
            "Questions: parents and instructions with a pair of which both networks trained; "
            "several pairs of one question count by their mean.",
            "Loss, factor: the geometric mean of the arm's recorded fitness as a multiple of the reference's, in "
            "brackets Student's interval of 95 %; below 1 the arm's networks are better. p: Wilcoxon's signed ranks; "
            f"corrected after Holm over the arms. Neither is given for fewer than {LEAST} questions.",
            "SD of a question: of the difference of logarithms. It says how many questions the next comparison needs: "
            "(2.8 SD / log factor)^2 for a power of 80 % at 5 %.",
            "Trained: the part of the arm's answers that gave a trained network; its p is that of the sign test over "
            "questions of which one of both arms trained more.",
            *_left_out("Without a partner", pairs.unpaired),
            *_left_out("Asked by the very request of the reference, whose recorded answer both have", pairs.shared),
        ),
    )


def _diversity(pairs: Pairs, name: str) -> Table:
    assert pairs.diversity is not None
    frame = pairs.diversity.assign(arm=pairs.diversity.index)
    layout: Layout = {"arm": "arm", "questions": "questions"}
    for measure, words in (("text", "text"), ("operations", "operations"), ("equal", "equal networks")):
        if frame[measure].notna().any():
            layout = {
                **layout,
                words: measure,
                f"{words}, difference": (
                    interval_cell,
                    *(f"{measure}_difference{end}" for end in ("", "_low", "_high")),
                ),
                f"{words}, p": (PValue, f"{measure}_p"),
                f"{words}, p, Holm": (PValue, f"{measure}_p_holm"),
            }
    count = counted(int(frame[[name for name in frame if str(name).endswith("_p")]].count().sum()), "p")
    return Table.of(
        frame,
        layout,
        name="pairs_diversity",
        caption=f"How far the answers of {name} to one question lie apart, against those of {pairs.reference}.",
        notes=(
            "Of each question, the mean over every two of its answers that trained; then the mean over questions that "
            "both arms have; the reference's own row is over all of its questions. 0: alike, 1: nothing in common.",
            "Text: Jaccard's distance of the runs of three tokens, without comments and layout. Operations: Jaccard's "
            "distance of the operations that the networks call, each as often as it is called. Equal networks: the "
            "part of the pairs of answers that are one network, whatever its comments and layout.",
            "Difference: from the reference, with Student's interval of 95 %. p: Wilcoxon's signed ranks over "
            f"questions, corrected after Holm over {count} of this table. Neither is given for fewer than {LEAST} "
            "questions.",
        ),
    )


def _left_out(why: str, counts: Mapping[str, int]) -> list[str]:
    """Say which answers are no pairs, a sentence; nothing where there are none."""
    arms = listed(f"{arm} ({number})" for arm, number in counts.items())
    return [f"{why}, and left out: answers of {arms}."] if counts else []


def _questions(is_reference: bool, questions: int) -> int | None:
    return None if is_reference else questions


def _whole(value: float) -> int:
    return round(value)
