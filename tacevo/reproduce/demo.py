"""What `make demo` gives everywhere: its digest, and whether a run of it has that digest.

The digest stands here once. README shows it, and a test compares both, and it with the recorded run.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from tacevo.config.compose import compose
from tacevo.config.identity import config_hash
from tacevo.environment import deviations, versions
from tacevo.results.run import RecordedRun
from tacevo.results.study_directory import StudyDirectory
from tacevo.rules import CURRENT
from tacevo.text import counted, listed


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """The noise run that the demo ends with, as it was recorded."""

    digest: str
    #: Elites, and training seeds of each network.
    elites: int
    seeds: int
    #: Of the packages whose bits decide.
    versions: Mapping[str, str]


DEMO = Recorded(
    digest="eee454d4015bb981d2ab6587441f0409fb11cd5f2fa4f5d352e94afab977aa80",
    elites=2,
    seeds=12,
    versions={"torch": "2.13.0+cpu", "numpy": "2.4.6"},
)


def compared(run: RecordedRun, noise: StudyDirectory) -> str:
    """Say whether the noise run of a demo has the recorded digest, else why it may not; of another run nothing."""
    study = noise.read()
    is_demo = config_hash(run.config) == config_hash(compose(["experiment=demo"])) and run.rules == CURRENT
    if not is_demo or (len(study.networks) - 1, study.seeds) != (DEMO.elites, DEMO.seeds):
        return ""
    if study.digest == DEMO.digest:
        trained = sum(line.evaluation is not None for line in run.candidates)
        trainings = counted(trained + len(study.networks) * study.seeds, "training")
        return f"equal to the digest in README: all {trainings} have the same bits as there"
    others = deviations(DEMO.versions, versions())
    computes = "a CPU that computes otherwise (`tacevo doctor` compares it)"
    why = f"other versions ({listed(others)})" if others else computes
    return (
        f"another digest than README's, {DEMO.digest}, which is no failure: {why}, or a candidate at its limit of time "
        "or memory; docs/determinism.md says where bits are equal"
    )
