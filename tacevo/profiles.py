"""The profiles of a finished run's networks: recalled from its store of probes, or probed anew in the sandbox."""

import hashlib
from pathlib import Path

from tacevo.errors import RunError
from tacevo.gate.admission import Admitted
from tacevo.records import Mode, Profile
from tacevo.replaying import read_run
from tacevo.rundir import RunDirectory
from tacevo.sandbox.confinement import require
from tacevo.wiring import open_gate


def recall_profiles(path: Path, store: str | None, mode: Mode = Mode.record) -> dict[str, Profile]:
    """Give the profile of every trained candidate of a run, by id, in the order of its ledger.

    A probe that is missing, e.g. because an older version of this package made the run, is made and stored; the code of
    a candidate runs in a confined process, as in a search.

    Args:
        path: the run directory.
        store: where the stores lie, if not where the run had them.
        mode: of the store of probes; with `replay`, no candidate's code runs, and a missing probe is an error.

    Raises:
        CacheMissError: a probe is missing and the mode is `replay`.
        RunError: a candidate's file is not what was trained, or its source passes the probe no longer.
        SandboxError: a probe is missing and the sandbox is broken.
    """
    directory = RunDirectory(path)
    config, task, _ = read_run(directory)
    if store is not None:
        config.store.root = store
    if mode is not Mode.replay:
        require(config.sandbox.require)
    with directory.believed():
        trained = {line["id"]: line["source"] for line in directory.read_ledger() if "fitness" in line}
    sources = {name: _source(directory, name, digest) for name, digest in trained.items()}
    distinct = dict.fromkeys(sources.values())
    with open_gate(config, task.contract, mode) as (gate, executor):
        verdicts = dict(zip(distinct, executor.map(gate.measure, distinct), strict=True))
    found = {}
    for name, source in sources.items():
        verdict = verdicts[source]
        if not isinstance(verdict, Admitted):
            raise RunError(f"{name} of {path} was trained, but is turned away now: {verdict.reason}: {verdict.detail}")
        found[name] = verdict.profile
    return found


def _source(directory: RunDirectory, name: str, digest: str) -> str:
    """Read a candidate's source, and hold it against what its ledger line says was trained."""
    source = directory.read_kept(name)
    if source is None or hashlib.sha256(source.encode()).hexdigest() != digest:
        raise RunError(
            f"{directory.path}/candidates/{name}.py is missing, or is not what was trained; restore the file"
        )
    return source
