"""Tables as files, those that a paper needs first; the page that says which question each answers."""

import re
from collections import Counter
from collections.abc import Collection, Iterable
from pathlib import Path
from urllib.parse import quote

from analysis.table import Table
from analysis.tables.rendering import ALL, Shown, table_texts
from tacevo.results.study_directory import NAME
from tacevo.storage.files import write_durably
from tacevo.text import counted, in_markdown

#: The tables that a paper needs, by kind, with the question that each answers.
PAPER = {
    "ablation": "How good are the arms, in every metric?",
    "ablation_primary": "Which arms differ from the reference in the primary metric?",
    "verdicts": "Which networks are better than the baseline, and which are as good?",
    "transfer": "Do the networks keep their advantage on other data?",
    "transfer_joint": "What do all data sets together say of it?",
    "transfer_sensors": "How good is each network on a sensor that it was not trained on?",
    "noise": "What were the recorded fitnesses worth: losses under other training seeds?",
    "gate": "How many answers became networks, and why were the others rejected?",
    "searches": "Which of these searches found better networks?",
    "published": "What does the paper print, and what would be correct?",
    "beside_published": "How does this compare with the published searches?",
}

#: The further ones, which lie in the directory `more`.
FURTHER = {
    "choice": "Which elite was handed over for a study, and by which losses?",
    "ablation_metric": "Which arms differ from the reference in this metric?",
    "ablation_settings": "In which settings do the arms differ?",
    "ablation_runs": "What did every job reach?",
    "corrected": "Which elites would the archive hold by their re-estimated fitness?",
    "costs": "What did the answers cost?",
    "effects": "How large is every difference from the baseline, with its interval?",
    "ensembles": "How good are the seeds of a network together, on the same test images?",
    "generations": "How did the search go, generation by generation?",
    "health": "Did the search work as it should?",
    "image_outputs": "How good is each output, on the same test images?",
    "improvement": "How much of the improvement is luck?",
    "instruction_mix": "Which instructions did each arm come to ask for?",
    "lineage": "How did the best network come about?",
    "metrics": "What are all test metrics of every network?",
    "motifs": "Which structures do good networks have in common?",
    "models": "What came of the answers of each model?",
    "niches": "How full are the niches?",
    "outputs": "How good is each output of the networks?",
    "instruction_effects": "What did each instruction do to the loss, and did the search ask for it more often?",
    "pareto": "Which networks does no other one beat in both loss and FLOPs?",
    "prompts": "Which instructions were productive?",
    "ranking": "Does the search rank its elites as other training seeds do?",
    "fitness_rules": "Would another `training.fitness` tell the networks apart better?",
    "scores": "What did every network score with every seed?",
    "temperatures": "Which temperatures were productive?",
}

#: The file that lists them.
INDEX = "index.md"


def for_paper(tables: Iterable[Table]) -> list[Table]:
    """Return the tables that a paper needs, in their order there."""
    order = list(PAPER)
    return sorted((table for table in tables if table.kind in PAPER), key=lambda table: order.index(table.kind))


def place_of(table: Table) -> str:
    """Return the place of a table's files, without ending: `gate`, `STUDY/verdicts`, or below `more`."""
    return table.name if table.kind in PAPER else f"more/{table.name}"


def table_files(
    tables: Iterable[Table], *, prefix: str = "", runs: Iterable[str] = (), show: Shown = ALL
) -> dict[str, str]:
    """Return every table in every format by its place, and the index of them all (`index_of`).

    The prefix is that of their labels in LaTeX, so that tables of several runs may stand in one document; `show` says
    what Markdown and LaTeX have of them.
    """
    known = list(tables)
    files = {
        f"{place_of(table)}{ending}": text
        for table in known
        for ending, text in table_texts(table, prefix=prefix, show=show).items()
    }
    return {INDEX: index_of(known, runs), **files}


def index_of(tables: Iterable[Table], runs: Iterable[str] = ()) -> str:
    """Write the page that says which question each table answers, those that a paper needs first.

    `runs` are the names of runs and sweeps whose own pages lie in directories of these names beside it.
    """
    known = list(tables)
    more = [table for table in known if table.kind not in PAPER]
    places = [f"- [{in_markdown(name)}]({quote(name, safe='')}/{INDEX}): all tables of this one" for name in runs]
    first = [*places, *map(_line, for_paper(known))]
    parts = ["# Tables", "", *first, *(["", "## More", ""] if first and more else []), *map(_line, more)]
    return "\n".join([*parts, "", "Each is there as .md, .tex and .csv; .csv is unrounded.", ""])


def _line(table: Table) -> str:
    question = (PAPER | FURTHER).get(table.kind, table.caption)
    return f"- [{in_markdown(table.name)}]({quote(place_of(table))}.md): {in_markdown(question)}"


def write_tables(
    tables: Iterable[Table], directory: Path, *, prefix: str = "", runs: Iterable[str] = (), show: Shown = ALL
) -> None:
    """Write the files of tables (`table_files`), each whole; older ones of the same names are replaced.

    Raises:
        StoreError: a file cannot be written.
    """
    for name, text in table_files(tables, prefix=prefix, runs=runs, show=show).items():
        write_durably(directory / name, text)


def left_of_studies(directory: Path, places: Collection[str], endings: Collection[str]) -> list[str]:
    """Name what lies there of studies and was not written now: of one that is left out, or of another run.

    Args:
        directory: of tables or of figures.
        places: of what was written, without ending.
        endings: of the files that the command writes.

    Returns:
        A remark on each directory of a study.
    """
    of_study = re.compile(rf"(more/)?{NAME}/[^/]+")
    others: Counter[Path] = Counter()
    for path in directory.rglob("*.*"):
        file = path.relative_to(directory)
        place = file.with_suffix("").as_posix()
        if path.suffix in endings and of_study.fullmatch(place) and place not in places:
            others[path.parent] += 1
    return [
        f"{folder}: {counted(number, 'file')} not written now, of a study that is left out, or of another run"
        for folder, number in sorted(others.items())
    ]
