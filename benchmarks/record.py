"""What `make bench` leaves: one JSON file of figures, and the table of them in benchmarks/README.md."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.timing import Figure, number
from tacevo.environment import checked_out, machine, versions
from tacevo.records import to_json

#: Between these lines of the page stands the table.
BEGIN, END = "<!-- make bench writes this table -->", "<!-- end of the table -->"


def record(figures: Sequence[Figure], date: str, peer: str) -> dict[str, Any]:
    """Describe a measurement: what was found, when, on which machine and with which versions.

    Args:
        figures: in the order in which they were taken.
        date: in ISO's form.
        peer: the peer's version.
    """
    return {
        "date": date,
        "machine": machine(),
        "checkout": to_json(checked_out()),
        "versions": {**versions(), "ribs": version("ribs"), "openevolve": peer},
        "figures": [{**asdict(figure), "ratio": figure.ratio} for figure in figures],
    }


def write(measured: Mapping[str, Any], results: Path, page: Path) -> None:
    """Write a record as JSON, and its table into a page.

    Raises:
        ValueError: the page has no place for it; the record is written.
    """
    results.write_text(json.dumps(measured, indent=1) + "\n", encoding="utf-8")
    page.write_text(with_table(page.read_text(encoding="utf-8"), list(table(measured))), encoding="utf-8")


def table(measured: Mapping[str, Any]) -> Iterator[str]:
    """Write the lines of a Markdown table: a row for each figure that has a peer.

    Args:
        measured: what `record` returns, or its JSON.
    """
    cpu, cores, measured_on = measured["machine"]["cpu"], measured["machine"]["cores"], measured["date"]
    yield f"Measured on {measured_on}: {cpu}, {cores} cores, torch {measured['versions']['torch']}."
    yield ""
    yield "| figure | ours | peer | ratio |"
    yield "|---|---|---|---|"
    for figure in measured["figures"]:
        if figure["ratio"] is not None:
            ours = f"{figure['name']}: {number(figure['value'])} {figure['unit']}"
            peer = f"{figure['peer']}: {number(figure['peer_value'])} {figure['unit']}"
            yield f"| {figure['title']} | {ours} | {peer} | {figure['ratio']:.2f} |"


def with_table(page: str, lines: Sequence[str], begin: str = BEGIN, end: str = END) -> str:
    """Return a page with these lines between two markers.

    Raises:
        ValueError: it does not have each marker once.
    """
    before, after = page.split(begin), page.split(end)
    if len(before) != 2 or len(after) != 2:
        raise ValueError(f"the page needs the lines {begin!r} and {end!r}, each once")
    return "\n".join([f"{before[0]}{begin}", "", *lines, "", f"{end}{after[1]}"])
