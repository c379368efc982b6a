"""The finished noise runs of a run, and which one elites are chosen by."""

import shlex

from tacevo.errors import RunError
from tacevo.results.run import RecordedRun
from tacevo.results.study_directory import studies_of
from tacevo.results.study_lines import StudyRecord


def noise_digest(run: RecordedRun) -> str:
    """Return the digest of a run's noise run; of several, that of the most networks, then seeds.

    Raises:
        RunError: none is finished.
    """
    runs = [(len(noise.networks), noise.seeds, str(noise.digest)) for noise in noise_runs(run)]
    if not runs:
        path = run.directory.path
        raise RunError(
            "a run without a finished noise run",
            place=str(path),
            expected="one to choose the elites by",
            remedy=f"run `tacevo noise {shlex.quote(str(path))}`",
        )
    return max(runs)[-1]


def noise_runs(run: RecordedRun) -> list[StudyRecord]:
    """List the finished noise runs of a run as it is now, by name."""
    every = [directory.read() for directory in studies_of(run.directory.path)]
    return [one for one in every if one.is_noise and one.digest is not None and one.run == run.ledger.digest]
