"""An output is tried with a recorded run or sweep: what it raises, and what of it cannot be written."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from analysis.report.collection import collection_of, read_studies
from analysis.report.outputs import Outputs, Say, unsaid
from analysis.report.page.sections import sections_contents
from analysis.tables.rendering import table_texts
from tacevo.api.opening import open as open_path
from tacevo.api.runs import Run
from tacevo.api.sweeps import Sweep
from tacevo.errors import CacheMissError, RunError
from tacevo.parts.kinds import OUTPUTS
from tacevo.parts.output import Output
from tacevo.parts.registry import Part
from tacevo.parts.registry import ours as our_parts
from tacevo.runs.profiles import recall_profiles

if TYPE_CHECKING:
    from analysis.report.figure_list import Picture


def faults_of(output: Output, path: str | os.PathLike[str]) -> list[str]:
    """Have an output make all that it adds to a run or a sweep, twice; return what is wrong with it, a sentence each.

    Raises:
        TacevoError: the run or the sweep cannot be opened.
    """
    kind = type(output)
    ours = [part for part in our_parts(OUTPUTS) if (part.module, part.attribute) == (kind.__module__, kind.__name__)]
    own = Part(kind=OUTPUTS, name=kind.__name__, module=kind.__module__, attribute=kind.__name__, origin="this module")
    part = ours[0] if ours else own
    known, one = Outputs(known=((part, output),), missing={}), open_path(path)
    faults: list[str] = []

    def made(say: Say) -> list[object]:
        return _of_sweep(known, one, say) if isinstance(one, Sweep) else _of_run(known, one, say)

    if made(faults.append) != made(unsaid):
        faults.append("expected the same again of the same records; got another table, or another section")
    return faults


def _of_run(known: Outputs, run: Run, say: Say) -> list[object]:
    """Return all that an output adds to a run, as it is written."""
    from analysis.report.figure_list import pictures_of, with_others  # Matplotlib takes a second to import

    collection = collection_of(run.recorded, read_studies(run.recorded), known)
    for remark in collection.remarks:
        if remark.startswith("no findings of "):
            say(remark)
    try:
        profiles = recall_profiles(run.recorded)
    except (CacheMissError, RunError):
        profiles = None
    tables = [*known.tables(collection, profiles, say), *known.beside([run.recorded], say)]
    for study in collection.studies:
        tables += known.study_tables(collection, study, say)
    for again in collection.reestimates:
        tables += known.reestimate_tables(collection, again, say)
    _draw(with_others(pictures_of(collection), known.figures(collection, say), say), say)
    return [*map(table_texts, tables), *sections_contents(known.sections(collection, say), say)]


def _of_sweep(known: Outputs, sweep: Sweep, say: Say) -> list[object]:
    """Return all that an output adds to a sweep, as it is written."""
    from analysis.report.figure_list import sweep_pictures, with_others

    collected = sweep.collection()
    tables = known.sweep_tables(collected, say)
    _draw(with_others(sweep_pictures(collected), known.sweep_figures(collected, say), say), say)
    return [*map(table_texts, tables), *sections_contents(known.sweep_sections(collected, say), say)]


def _draw(pictures: Iterable[Picture], say: Say) -> None:
    """Draw those pictures that are not ours."""
    from analysis.report.figure_list import write_pictures

    with TemporaryDirectory() as folder:
        others = [picture for picture in pictures if picture.part is not None]
        write_pictures(others, Path(folder), (".png",), lambda name: None, say)
