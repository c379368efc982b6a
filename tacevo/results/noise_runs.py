"""The finished noise runs of a run: which one elites are chosen by, and what it says of them."""

import math
import shlex
from pathlib import Path
from statistics import median

from tacevo.errors import RunError
from tacevo.results.run import RecordedRun
from tacevo.results.study_directory import studies_of
from tacevo.results.study_lines import ScoreLine, StudyRecord
from tacevo.text import listed


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
    return [one for one in every if one.terms is None and one.digest is not None and one.run == run.ledger.digest]


def estimates_of(run: Path, digest: str) -> dict[str, float]:
    """Return the re-estimated fitness of the networks of a noise run, by id: the median over its seeds.

    A network is left out where one of its trainings failed.

    Args:
        run: its directory.
        digest: of the noise run.

    Raises:
        RunError: the run does not have it, or it was edited.
    """
    for directory in studies_of(run):
        if directory.read().digest == digest:
            losses: dict[str, list[float]] = {}
            for row in directory.read_finished().scores.rows:
                losses.setdefault(row.id, []).append(row.validation_loss if isinstance(row, ScoreLine) else math.inf)
            return {name: median(values) for name, values in losses.items() if max(values) < math.inf}
    raise RunError(
        f"studies of the digests {listed(str(each.read().digest)[:12] for each in studies_of(run))}",
        place=f"{run}/studies",
        expected=f"the noise run {digest[:12]} that the elites of a study were chosen by",
        remedy="`tacevo noise` with its settings makes it again; of a bundle, publish both",
    )
