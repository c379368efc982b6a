"""Tables of what instructions and temperatures did to a child's loss, and of which instructions were asked for."""

from collections.abc import Mapping, Sequence

import pandas as pd

from analysis.runs.instruction_effects import instruction_effects, late_shares
from analysis.statistics.effects import LEVEL
from analysis.table import Between, Percent, PValue, Table
from tacevo.results.run import RecordedRun

#: Said wherever temperatures of a grammar are compared.
GRAMMAR_TEMPERATURE = (
    "The grammar's temperature is a mutation strength, the number of random edits beside the instruction, and not the "
    "sampling temperature of a model."
)


def grammar_note(runs: Sequence[RecordedRun]) -> tuple[str, ...]:
    """Say what a temperature is where the grammar answered."""
    return (GRAMMAR_TEMPERATURE,) if any(not run.config.llm.facts.is_model for run in runs) else ()


def instructions_table(runs: Sequence[RecordedRun], of: str) -> Table:
    """Show what each instruction did in one or several searches, and what a temperature does."""
    effects = instruction_effects(runs)
    return Table.of(
        effects,
        {"instruction": "name", "requests": "requests", "children": "children"}
        | {"factor of the loss": (Between, "effect", "effect_low", "effect_high")}
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
