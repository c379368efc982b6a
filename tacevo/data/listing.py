"""The files of a directory that are not in the data set, or lie elsewhere, where a user may not expect it."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path, PurePath

from tacevo.data.source import SHOWN_FAULTS, listed
from tacevo.data.sources.filenames import hidden_part
from tacevo.parts.source import Catalogue
from tacevo.text import counted


def doubtful_files(catalogue: Catalogue, root: Path) -> Iterator[str]:
    """Say, a sentence each, which images are passed over or lie elsewhere, and which lines of the table are empty."""
    if catalogue.passed_over:
        found = Counter(map(_group, catalogue.passed_over))
        names = [name if count == 1 else f"{name} ({count})" for name, count in sorted(found.items())]
        images = counted(len(catalogue.passed_over), "image")
        yield (
            f"passed over: {images} in {root}, hidden or left there by systems and programs: {', '.join(names)}; "
            "rename what belongs to the data set"
        )
    if catalogue.blank:
        lines = listed(list(map(str, catalogue.blank)), most=SHOWN_FAULTS)
        yield f"passed over: {counted(len(catalogue.blank), 'empty row')} of the table, line {lines}"
    if catalogue.linked:
        images = counted(len(catalogue.linked), "image")
        yield f"outside {root}, where links lead: {images}, {listed(list(catalogue.linked), most=SHOWN_FAULTS)}"


def _group(path: PurePath) -> str:
    """Return what images are passed over for, the stubs of a Mac as one."""
    part = hidden_part(path) or path.name
    return "._*" if part.startswith("._") else part
