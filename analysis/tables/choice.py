"""What chose the elites of a study: the table of a choice, and a note on a study whose elites were chosen by losses."""

from analysis.table import Cell, Table
from tacevo.choices import ChosenBy
from tacevo.evolution.archive import best_distinct
from tacevo.results.study_directory import FinishedStudy
from tacevo.results.study_lines import Design, FailedLine, ScoreLine, is_late
from tacevo.text import counted, listed


def chosen_note(study: Design) -> tuple[str, ...]:
    """Say what the elites of a study were chosen by, if not by their recorded fitness."""
    match study.choose:
        case ChosenBy.reestimated:
            return (f"Elites chosen by the noise run with the digest {study.chosen_by[:12]}.",)
        case ChosenBy.validated if len(study.networks) > 1:
            return (
                f"{study.networks[1].name}: of {study.validated} elites, or fewer, the one with the lowest validation "
                f"loss in one training of {counted(study.recipe.epochs, 'epoch')} each, by a seed that does not test "
                f"(the choice with the digest {study.chosen_by[:12]}). The baseline is not chosen among several.",
            )
        case _:
            return ()


def choice_table(choice: FinishedStudy) -> Table:
    """Show the validation loss of each elite and of the baseline, the network that is handed over, and what it cost."""
    header, rows = choice.header, {row.id: row for row in choice.rows}
    baseline, *elites = header.networks
    scores = {name: row for name, row in rows.items() if isinstance(row, ScoreLine)}
    losses = [(scores[one.id].validation_loss, one.id, one.source) for one in elites if one.id in scores]
    first = next(iter(best_distinct(losses, baseline.source)), None)
    failed = [f"{one.name} ({row.reason})" for one in header.networks if isinstance(row := rows[one.id], FailedLine)]
    late = sum(is_late(row, header.recipe.epochs) for row in scores.values())
    cells: list[tuple[Cell, ...]] = []
    for network in header.networks:
        score, mark = scores.get(network.id), "handed over" if network.id == first else None
        loss, epoch = (None, None) if score is None else (score.validation_loss, score.epoch)
        cells.append((network.name, network.id, network.fitness, loss, epoch, mark))
    trainings = counted(len(header.networks), "training")
    return Table(
        name="choice",
        caption=f"{header.task}: one of {counted(len(elites), 'elite')}, chosen by the validation loss of one training "
        f"of {counted(header.recipe.epochs, 'epoch')} each",
        columns=("network", "candidate", "fitness, one draw", "validation loss", "best epoch", "choice"),
        rows=tuple(cells),
        notes=(
            f"{trainings}, with one seed that no study tests with. No test image was seen.",
            "The baseline is not chosen among several. In a sweep it takes its own place, if its loss is the lowest.",
            *([f"Not trained to the end, so not handed over: {listed(failed)}."] if failed else []),
            *(
                [f"{late} of {trainings} had the best epoch in the last tenth; more epochs= may choose another."]
                if late
                else []
            ),
        ),
    )
