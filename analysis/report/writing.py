"""Tables as files, those that a paper needs first; the page that says which question each answers."""

import re
from collections.abc import Collection, Iterable
from pathlib import Path

from analysis.table import Table
from analysis.tables.rendering import table_texts
from tacevo.results.study_directory import NAME
from tacevo.storage.files import write_durably

#: The tables that a paper needs, by name, with the question that each answers.
PAPER = {
    "ablation": "How good are the arms, in every metric?",
    "verdicts": "Which networks are better than the baseline, and which are as good?",
    "noise": "What were the recorded fitnesses worth: losses under other training seeds?",
    "gate": "How many answers became networks, and why were the others rejected?",
    "searches": "Which of these searches found better networks?",
    "beside_published": "How does this compare with the published searches?",
}

#: The further ones, which lie in the directory `more`.
FURTHER = {
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
    "lineage": "How did the best network come about?",
    "metrics": "What are all test metrics of every network?",
    "motifs": "Which structures do good networks have in common?",
    "niches": "How full are the niches?",
    "outputs": "How good is each output of the networks?",
    "prompts": "Which instructions were productive?",
    "ranking": "Does the search rank its elites as other training seeds do?",
    "scores": "What did every network score with every seed?",
    "temperatures": "Which temperatures were productive?",
    "transfer": "Do the networks keep their advantage on other data?",
}

#: The file that lists them.
INDEX = "index.md"


def for_paper(tables: Iterable[Table]) -> list[Table]:
    """Return the tables that a paper needs, in their order there: also the arms in every metric, and published ones."""
    order = list(PAPER)
    return sorted((table for table in tables if _kind(table) in PAPER), key=lambda table: order.index(_kind(table)))


def _kind(table: Table) -> str:
    """Return the name of a table without its study; of those of one kind, the name of the kind."""
    name = table.name.rpartition("/")[2]
    if name in FURTHER:
        return name
    return {"ablation": "ablation", "published": "beside_published", "searches": "searches"}.get(
        name.partition("_")[0], name
    )


def place_of(table: Table) -> str:
    """Return the place of a table's files, without ending: `gate`, `STUDY/verdicts`, or below `more`."""
    return table.name if _kind(table) in PAPER else f"more/{table.name}"


def table_files(tables: Iterable[Table], *, prefix: str = "") -> dict[str, str]:
    """Return every table in every format by its place, and the index of them all.

    The prefix is that of their labels in LaTeX, so that tables of several runs may stand in one document.
    """
    known = list(tables)
    files = {
        f"{place_of(table)}{ending}": text
        for table in known
        for ending, text in table_texts(table, prefix=prefix).items()
    }
    return {INDEX: index_of(known), **files}


def index_of(tables: Iterable[Table]) -> str:
    """Write the page that says which question each table answers, those that a paper needs first."""
    known = list(tables)
    more = [table for table in known if _kind(table) not in PAPER]
    parts = ["# Tables", "", *map(_line, for_paper(known)), *(["", "## More", ""] if more else []), *map(_line, more)]
    return "\n".join([*parts, "", "Each is there as .md, .tex and .csv; .csv is unrounded.", ""])


def _line(table: Table) -> str:
    return f"- [{table.name}]({place_of(table)}.md): {_question(table)}"


def _question(table: Table) -> str:
    name = table.name.rpartition("/")[2]
    return PAPER.get(name) or FURTHER.get(name) or table.caption


def write_tables(tables: Iterable[Table], directory: Path, *, prefix: str = "") -> None:
    """Write tables in every format with their index, each file whole; older ones of the same names are replaced.

    Raises:
        StoreError: a file cannot be written.
    """
    for name, text in table_files(tables, prefix=prefix).items():
        write_durably(directory / name, text)


def remove_outdated(directory: Path, places: Collection[str], endings: Collection[str]) -> list[str]:
    """Remove what an earlier command wrote there of studies that are missing or rejected now.

    Args:
        directory: of tables or of figures.
        places: of those that are current, without ending; other files than those of a study are left alone.
        endings: of the files that the command writes.

    Returns:
        A remark on each removed file.
    """
    of_study = re.compile(rf"(more/)?{NAME}/[^/]+")
    found = {path: path.relative_to(directory).with_suffix("").as_posix() for path in sorted(directory.rglob("*.*"))}
    gone = [
        path
        for path, place in found.items()
        if path.suffix in endings and of_study.fullmatch(place) and place not in places
    ]
    for path in gone:
        path.unlink()
    for folder in {path.parent for path in gone}:
        if not any(folder.iterdir()):
            folder.rmdir()
    return [f"removed {path.relative_to(directory)}: its study is missing or left out" for path in gone]
