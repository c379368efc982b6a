"""The command `tacevo pairs`."""

from pathlib import Path

from rich.console import Console

from analysis.report.writing import write_tables
from analysis.tables.pairs import pairs_tables
from tacevo.api.runs import Run
from tacevo.cli.common import DONE, output_directory, tell
from tacevo.cli.tables import open_all, print_table, say
from tacevo.errors import RunError
from tacevo.runs.progress import Progress


def run_pairs(name: str, place: Path, reference: str | None, store: str | None, *, other_parents: bool) -> int:
    """Compare the arms of a sweep answer by answer: print the tables, and write them into a place."""
    (sweep,) = open_all([name], store)
    if isinstance(sweep, Run):
        raise RunError("one run", place=name, expected="a sweep of two arms or more")
    with Progress() as view:
        view.say("comparing the answers of the arms")
        tables = pairs_tables(sweep.pairs(reference, other_parents=other_parents), sweep.name)
    write_tables(tables, output_directory(place))
    for table in tables:
        print_table(table, Console())
    say(sweep.left_out)
    tell(f"tables: {place}")
    return DONE
