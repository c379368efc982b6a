"""The table of how the niches of both archives are filled."""

from analysis.runs.coverage_map import coverage_map, effective_niches, reachable
from analysis.runs.dynamics import progress
from analysis.runs.niches import Niches, reachable_prompt_niches, reachable_temperatures
from analysis.table import Cell, Percent, Table, percent
from tacevo.results.run import RecordedRun
from tacevo.text import counted


def niches_table(run: RecordedRun, niches: Niches) -> Table:
    """Show how the niches of both archives are filled, of all and of those that could be reached.

    An archive that the run does not have, or that has no niches, has no row.
    """
    rows: list[tuple[Cell, ...]] = []
    notes: list[str] = []
    if run.bounds is not None:
        placed = coverage_map(run, niches.networks)
        filled = _filled(len(run.elites), len(reachable(placed, niches.networks)), run.places)
        rows.append(("networks", *filled, effective_niches(placed), int(progress(run).lost.sum())))
        notes += [
            "Networks: a niche counts as reachable if a trained candidate lies in it, or between trained candidates.",
            "Effective: exp of the entropy of the trained candidates over the niches; so many equally full niches "
            "would be as uneven. Lost: niches that emptied as bounds moved, less those that filled so.",
        ]
    if run.has_prompts:
        reached = len(reachable_prompt_niches(run, niches.prompts))
        rows.append(("prompts", *_filled(len(run.prompt_trials), reached, len(niches.prompts)), None, None))
        notes.append(_reach(run))
    return Table(
        name="niches",
        caption=f"How the niches of {run.name} are filled at its end.",
        columns=("archive", "niches", "occupied", "coverage", "reachable", "coverage of these", "effective", "lost"),
        rows=tuple(rows),
        notes=tuple(notes),
    )


def _filled(occupied: int, reached: int, total: int) -> tuple[Cell, ...]:
    return total, occupied, Percent(occupied / total), reached, percent(occupied / reached if reached else None)


def _reach(run: RecordedRun) -> str:
    """Explain which niches of the prompt archive could be reached."""
    temperatures = reachable_temperatures(run)
    if not temperatures:
        return "Prompts: trials begin with generation 1, which the run does not have."
    rule, generations = run.config.temperature.rule, counted(run.generations[-1].generation, "generation")
    return (
        f"Prompts: a niche counts as reachable if it holds an instruction at a temperature{run.carried} that "
        f"temperature={rule} can lead to in {generations} ({min(temperatures):g} to {max(temperatures):g}), with "
        "any fitness that they find."
    )
