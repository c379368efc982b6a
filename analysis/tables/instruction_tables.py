"""Tables of what instructions and temperatures did to a child's loss, and of which instructions were asked for."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import pandas as pd

from analysis.runs.instruction_effects import instruction_effects, late_shares
from analysis.statistics.effects import LEVEL
from analysis.table import Interval, Percent, PValue, Table
from analysis.tables.grammar_note import carrier_notes, grammar_note
from tacevo.parts.output import Output
from tacevo.profile import Profile
from tacevo.results.run import RecordedRun

if TYPE_CHECKING:
    from analysis.report.collection import Collection
    from analysis.report.sweep_collection import SweepCollection


class InstructionEffects(Output):
    """Adds what each instruction did to the loss of a child, of a run and of all arms of a sweep."""

    def tables(self, run: "Collection", profiles: Mapping[str, Profile] | None) -> Sequence[Table]:
        """Make the table of a run."""
        return (instructions_table([run.run], run.run.name),)

    def sweep_tables(self, sweep: "SweepCollection") -> Sequence[Table]:
        """Make those of a sweep; none of searches of different libraries, which have nothing in common."""
        arms: dict[str, list[RecordedRun]] = {}
        for one in sweep.sweep.finished:
            arms.setdefault(one.job.arm, []).append(one.run)
        jobs, task = sweep.ablation.jobs, sweep.sweep.task
        distinct = set(jobs.index[~jobs.search.duplicated()])
        runs = [one.run for one in sweep.sweep.finished if one.job.name in distinct]
        if len({run.instructions for run in runs}) > 1:
            return ()
        return instructions_table(runs, f"all arms ({task})"), mix_table(arms, task)


def instructions_table(runs: Sequence[RecordedRun], of: str) -> Table:
    """Show what each instruction did in one or several searches, and what a temperature does."""
    effects = instruction_effects(runs)
    return Table.of(
        effects,
        {"instruction": "name", "requests": "requests", "children": "children"}
        | {"factor of the loss": (Interval, "effect", "effect_low", "effect_high")}
        | {"p": (PValue, "p"), "p, Holm": (PValue, "p_holm")}
        | {"share, first half": (Percent, "early"), "share, later half": (Percent, "late")},
        name="instruction_effects",
        caption=f"What each instruction of {of} did to the loss of a child.",
        notes=(
            "Factor: by how much an instruction moves a child's loss from that of the mean instruction; below 1 is "
            f"lower. In brackets its {100 * LEVEL:g} % interval. Fitted to the logarithms of the losses of "
            f"{int(effects.children.iloc[-1])} children of mutations that trained, with their "
            "generation, their parent's loss and their temperature; instructions are drawn at random, so it is an "
            "experiment, of single draws after a short training.",
            "p: of a factor of 1, two-sided; corrected after Holm over the instructions. Temperature + 1: what a whole "
            "unit would do, by the jitter within a generation; no part of that family.",
            "Share: of the requests of the first and the later half of the generations, by which one sees whether the "
            "search came to ask for what works.",
            *carrier_notes(runs),
            *grammar_note(runs),
        ),
    )


def mix_table(arms: Mapping[str, Sequence[RecordedRun]], of: str) -> Table:
    """Show the share of each instruction in the later half of the generations, arm by arm."""
    shares = pd.DataFrame({arm: late_shares(runs) for arm, runs in arms.items()}).rename_axis("name")
    return Table.of(
        shares.reset_index(),
        {"instruction": "name"} | {arm: (Percent, arm) for arm in arms},
        name="instruction_mix",
        caption=f"How often each instruction was asked for in the later half of the generations ({of}).",
        notes=("Shares of an arm's requests. A policy that learns moves them away from those of the reference.",),
    )
