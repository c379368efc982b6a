"""What is left of the archives of a sweep's runs once all their elites were trained again, in one archive for all."""

from dataclasses import replace
from pathlib import Path

from analysis.studies.corrected import Corrected, correct
from analysis.studies.noise import load_reestimates
from analysis.sweeps.common_archive import CommonArchive
from tacevo.errors import RunError, StoreError
from tacevo.results.run import RecordedRun, descriptors_of
from tacevo.results.study_directory import studies_of
from tacevo.results.sweep import RecordedSweep


def corrected_jobs(sweep: RecordedSweep, common: CommonArchive, store: Path | None) -> dict[str, Corrected]:
    """Fill the common archive with the elites of each job, as recorded and by their re-estimates.

    Args:
        sweep: whose finished jobs they are.
        common: what all runs are measured in.
        store: where the stores lie, if not where the runs had them.

    Returns:
        By the names of the jobs; one without a finished noise run (or such a study) of all its elites is left out.
    """
    found = {one.job.name: _corrected(one.run, common, store) for one in sweep.finished}
    return {name: one for name, one in found.items() if one is not None}


def _corrected(run: RecordedRun, common: CommonArchive, store: Path | None) -> Corrected | None:
    """Correct the archive of a run by the re-estimates of the most seeds that cover it."""
    sources = {one.id: one.source for one in run.candidates}
    points = {one.id: common.bounds.normalise(descriptors_of(one, common.scale)) for one in run.trained}
    elites = [replace(elite, niche=common.tessellation.niche_of(points[elite.id])) for elite in run.elites]
    found: list[tuple[int, Corrected]] = []
    for directory in studies_of(run.path):
        try:
            again = None
            if directory.read().run == run.digest:
                place = store or Path(run.config.store.root)
                again = load_reestimates(directory.read_finished(), run.config, run.facts.fingerprint, place)
        except (RunError, StoreError):
            continue  # `tacevo tables` of the run says why
        one = again and correct(elites, common.tessellation.niches, sources, again)
        if again and one:
            found.append((again.noise.seeds, one))
    return max(found, key=lambda one: one[0])[1] if found else None
