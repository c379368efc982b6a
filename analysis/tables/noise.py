"""Tables of what a run's recorded fitnesses are worth: their re-estimates, and how a fitness ranks the networks."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import pandas as pd

from analysis.rounding import shown
from analysis.statistics.effects import LEVEL
from analysis.studies.corrected import correct
from analysis.studies.noise import SeedNoise
from analysis.studies.reestimates import Reestimates
from analysis.table import Interval, Percent, Table
from analysis.tables.dynamics import TRIVIAL_LOSS
from tacevo.evolution.chance import chance_in_words, is_at_chance
from tacevo.parts.output import Output
from tacevo.text import counted

if TYPE_CHECKING:
    from analysis.report.collection import Collection

#: The column of the chances to beat the baseline.
BEATS = (Interval, "beats", "beats_low", "beats_high")
#: The column of the parts of the variance that are the networks'.
ICC = (Interval, "icc", "icc_low", "icc_high")


class Noise(Output):
    """Adds the tables of what a run's recorded fitnesses are worth, by its studies and noise runs."""

    def reestimate_tables(self, run: "Collection", again: Reestimates) -> Sequence[Table]:
        """Make them; that of the corrected archive where all of its elites were trained again."""
        sources = {candidate.id: candidate.source for candidate in run.run.candidates}
        archives = correct(run.run.elites, run.run.places, sources, again)
        corrected = () if archives is None else (corrected_table(archives, again, run.run.task),)
        return (*noise_tables(again, run.run.task, run.run.record.trivial), *corrected)


def noise_tables(again: Reestimates, task: str, trivial: float | None) -> tuple[Table, ...]:
    """Return all tables of a study's or a noise run's re-estimates, with the trivial loss where it is known."""
    known = SeedNoise(again)
    noise, ranked, worth = noise_table(again, task, trivial), known.rankings, known.worth
    if ranked is None or worth is None:
        return (noise,)
    return (noise, ranking_table(again, ranked, task), worth_table(again, worth, task))


def noise_table(again: Reestimates, task: str, trivial: float | None) -> Table:
    """Show the recorded fitness of each network beside what other training seeds give, and the trivial loss."""
    known, seeds = SeedNoise(again), counted(again.seeds, "other training seed")
    return Table.of(
        known.frame,
        {"network": "network", "candidate": "candidate", "recorded fitness": "recorded"}
        | {"re-estimated, median": "median", "least": "least", "most": "most"}
        | {"seeds as low as recorded": "as_low", "recorded less re-estimated": "optimism"}
        | {"expected by regression": "expected", "chance to beat the baseline": BEATS},
        name="noise",
        caption=f"What the recorded fitnesses of {task} are worth: the same networks under {seeds}.",
        last=() if trivial is None else (("trivial", None, trivial, trivial, *(None,) * 6),),
        notes=(
            *chance_note(again, trivial),
            f"Fitness: {again.fitness}, lower is better. The recorded one "
            "is one draw, by which the search chose; the others decided nothing in it.",
            "Recorded less re-estimated: below 0 the record flatters the network.",
            *_failed_note(again),
            _icc_note(known.icc),
            "Chance to beat the baseline: that one seed of the network has a lower loss than one of the baseline; in "
            f"brackets the {100 * LEVEL:g} % interval of Newcombe (2006, method 5).",
            *_agreement_note(known.agreement),
            *(() if trivial is None else (TRIVIAL_LOSS,)),
        ),
    )


def chance_note(again: Reestimates, trivial: float | None) -> tuple[str, ...]:
    """Say that no network's re-estimate is better than chance, where that is so."""
    best = min(again.medians)
    if trivial is None or not is_at_chance(best, trivial):
        return ()
    return (f"{chance_in_words(trivial)} By the medians of {counted(again.seeds, 'other seed')}.",)


def corrected_table(archives: pd.DataFrame, again: Reestimates, task: str) -> Table:
    """Show the figures of an archive as recorded beside those after its elites were trained again."""
    seeds, missing = counted(again.seeds, "other training seed"), archives.lost["reestimated"]
    lost = f"Their niches are empty, because a training failed: {', '.join(missing)}." if missing else ""
    before, after = archives.astype("object").where(archives.notna(), None).itertuples()
    return Table(
        name="corrected",
        caption=f"The archive of {task} as recorded, and filled again by the medians of {seeds} (corrected).",
        columns=("figure", "as recorded", "corrected"),
        rows=(
            ("QD-score", before.qd_score, after.qd_score),
            ("coverage", Percent(before.coverage), Percent(after.coverage)),
            ("best fitness", before.best, after.best),
            ("whose it is", before.best_id, after.best_id),
        ),
        notes=(
            "A recorded fitness is one draw, so each niche holds the luckiest of its "
            "candidates, and the figures grow with the noise (an illusory archive, Flageat and Cully 2023). Corrected "
            f"is what is left of it by {seeds}; its best is still the lowest of many medians. Candidates that lost to "
            "an elite were not trained again, so a better archive may lie in the run.",
            *([lost] if lost else []),
        ),
    )


def ranking_table(again: Reestimates, rankings: pd.DataFrame, task: str) -> Table:
    """Show how the fitness after some epochs ranks the networks, beside their test scores."""
    last = len(rankings)
    doubled = {2**power for power in range(last.bit_length())}
    return Table.of(
        rankings[rankings.epoch.isin(doubled | {again.epochs, last})],
        {"epochs": "epoch", "tau, one seed": "one_seed", "tau, median of the seeds": "median"},
        name="ranking",
        caption=f"How a fitness after so many epochs ranks the networks of {task}, beside their test scores "
        "(weights of the best validation epoch).",
        notes=(
            f"Kendall's tau over {counted(len(again.networks), 'network')}: 1 is the same order, 0 none. The first, "
            "third ... seed give the fitness and the others the test score, so no training stands on both sides. One "
            "seed: mean over the seeds of the fitness.",
            f"The search trained for {counted(again.epochs, 'epoch')}, with one seed.",
        ),
    )


def worth_table(again: Reestimates, worth: pd.DataFrame, task: str) -> Table:
    """Show what a fitness after the search's epochs would be worth by each rule."""
    return Table.of(
        worth,
        {"training.fitness": "rule"}
        | {"ICC of one training": ICC}
        | {"tau, one seed": "one_seed", "tau, median of the seeds": "median"},
        name="fitness_rules",
        caption=f"What a fitness of {task} is worth by each rule, after {counted(again.epochs, 'epoch')}.",
        notes=(
            "last: the loss after the last epoch, which is the paper's. lowest: the lowest loss. mean_of_3: the mean "
            f"of the last three. The search took {again.rule}.",
            f"ICC: the part of the variance between {counted(len(again.networks), 'network')} and "
            f"{counted(again.seeds, 'seed')} that is the networks', of logarithms ({100 * LEVEL:g} % interval). Tau: "
            "Kendall's, with the order by test scores of other seeds.",
            "The networks were chosen by one of these rules, so the others are judged by its choice.",
        ),
    )


def _failed_note(again: Reestimates) -> tuple[str, ...]:
    names = ", ".join(f"{network.name} ({network.id})" for network in again.failed)
    return (f"Left out, because a training with another seed failed: {names}.",) if names else ()


def _icc_note(icc: Interval | None) -> str:
    if icc is None:
        return (
            "No ICC, and hence no regression to the mean: it takes two networks, two seeds, and losses above 0 that "
            "differ."
        )
    part = shown(icc)
    expected = (
        "Expected by regression: what another seed typically gives (a geometric mean), by that ICC, to a network with "
        "this recorded fitness; below 0 it counts as 0, because no difference between networks was seen."
    )
    return (
        f"ICC(1), the part of the variance of one training's loss that is the network's: {part} "
        f"({100 * LEVEL:g} % interval; Shrout and Fleiss 1979; of logarithms, over these networks). {expected}"
    )


def _agreement_note(tau: float | None) -> tuple[str, ...]:
    if tau is None:
        return ()
    return (f"Kendall's tau of recorded and re-estimated fitness, over these networks: {shown(tau)}.",)
