"""The table of the networks that no other one beats in loss and FLOPs."""

from collections.abc import Mapping, Sequence

from analysis.rounding import shown
from analysis.runs.pareto import REESTIMATED, beside_costs, hypervolumes, on_front, reference_point
from analysis.table import Percent, Table
from tacevo.results.run import RecordedRun


def pareto_table(run: RecordedRun, again: Mapping[str, Sequence[float]]) -> Table:
    """Show the front of a run in loss and FLOPs.

    `again` are further losses of a source, by its SHA-256, as of `beside_costs`.
    """
    candidates = beside_costs(run, again)
    front = on_front(candidates, ["fitness", "flops"])
    return Table.of(
        front.reset_index(),
        {"candidate": "id", "fitness": "fitness", "fitness is": "estimate", "trainings": "draws"}
        | {"parameters": "parameters", "FLOPs": "flops"},
        name="pareto",
        caption=f"The networks of {run.name} that no other one beats in both fitness and FLOPs.",
        notes=(
            "Fitness: a validation loss, lower is better. FLOPs: of one image, forwards. Of equal networks the first "
            "counts.",
            *_mixed(set(front.estimate), set(candidates.estimate)),
            *_volume(run),
        ),
    )


def _mixed(shown_ones: set[str], all_ones: set[str]) -> tuple[str, ...]:
    """Warn of fitnesses by which the search chose: such a network may stand on the front because it was lucky."""
    if shown_ones <= {REESTIMATED}:
        return ()
    if REESTIMATED in all_ones:
        return (
            "A network that was trained again counts by its re-estimate, any other by the fitness by which the search "
            "chose, which flatters it: it may stand here by luck. tacevo noise RUN trains all elites again.",
        )
    return ("A fitness by which the search chose flatters its network; tacevo noise RUN trains all elites again.",)


def _volume(run: RecordedRun) -> tuple[str, ...]:
    reference = reference_point(run)
    if reference is None:
        return ()
    loss, flops = (shown(value) for value in reference)
    return (
        f"Hypervolume at the end: {shown(Percent(hypervolumes(run)[-1] or 0.0))} of the box between (0, 0) and the "
        f"reference point, by fitnesses as the search knew them. That point is the baseline's fitness, {loss}, and the "
        f"most FLOPs of any trained candidate, {flops}.",
    )
