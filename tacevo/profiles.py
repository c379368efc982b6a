"""The profiles of a finished run's networks: recalled from its store of probes, or probed anew in the sandbox."""

from collections.abc import Callable
from pathlib import Path

from tacevo.choices import Confinement
from tacevo.errors import RunError
from tacevo.gate.admission import Admitted
from tacevo.records import Mode, Profile
from tacevo.replaying import read_run
from tacevo.rundir import RunDirectory
from tacevo.sandbox.confinement import require
from tacevo.wiring import open_gate

#: Insists on a level of confinement.
Confine = Callable[[Confinement], None]


def recall_profiles(
    path: Path, store: str | None, *, mode: Mode = Mode.record, confine: Confine = require
) -> dict[str, Profile]:
    """Give the profile of every trained candidate of a run, by id, in the order of its ledger.

    A probe that is missing, e.g. because an older version of this package made the run, is made and stored; the code of
    a candidate runs in a confined process, as in a search.

    Args:
        path: the run directory.
        store: where the stores lie, if not where the run had them.
        mode: of the store of probes; with `replay`, no candidate's code runs, and a missing probe is an error.
        confine: raises where candidates cannot be confined as strongly as the run asks; only a missing probe needs it.

    Raises:
        CacheMissError: a probe is missing and the mode is `replay`.
        RunError: a candidate's file is not what was trained, or its source passes the probe no longer.
        SandboxError: a probe is missing and the sandbox is broken.
    """
    directory = RunDirectory(path)
    config, task, _ = read_run(directory, store)
    with directory.believed():
        trained = {line["id"]: line["source"] for line in directory.read_ledger() if "fitness" in line}
    sources = {name: directory.read_source(name, digest) for name, digest in trained.items()}
    distinct = dict.fromkeys(sources.values())
    with open_gate(config, task.contract, mode) as (gate, executor):
        if mode is not Mode.replay and not all(map(gate.is_recorded, distinct)):
            confine(config.sandbox.require)
        verdicts = dict(zip(distinct, executor.map(gate.measure, distinct), strict=True))
    found = {}
    for name, source in sources.items():
        verdict = verdicts[source]
        if not isinstance(verdict, Admitted):
            raise RunError(f"{name} of {path} was trained, but is turned away now: {verdict.reason}: {verdict.detail}")
        found[name] = verdict.profile
    return found
