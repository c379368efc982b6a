"""What tables say of the plan that a study or a sweep was given: it is a part of what is recorded."""

from analysis.rounding import shown
from analysis.table import Percent
from tacevo.storage.plan_file import Measure, SeedPlan
from tacevo.text import counted

#: What a value is, by the metric.
VALUES = {
    Measure.mse: "test MSE",
    Measure.accuracy: "test accuracy",
    Measure.loss: "test loss",
    Measure.fitness: "best fitness",
}


def plan_notes(plan: SeedPlan | None) -> tuple[str, ...]:
    """Say what a study or a sweep was planned to find; nothing without a plan."""
    if plan is None:
        return ()
    each = "seeds of each network" if plan.kind == "study" else "jobs of each arm"
    return (
        f"Planned: {plan.seeds} {each} and {counted(plan.comparisons, 'comparison')}, to find "
        f"{effect_in_words(plan.metric, plan.effect)} with a chance of {shown(Percent(plan.power))}; {plan.dated}.",
    )


def effect_in_words(metric: Measure, effect: float) -> str:
    """Say what a study or a sweep is to find."""
    if metric is Measure.accuracy:
        return f"{shown(100 * effect)} percentage points of {VALUES[metric]}"
    return f"{shown(Percent(effect))} less {VALUES[metric]}"
