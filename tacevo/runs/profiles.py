"""The profiles of a finished run's networks, from its store of probes."""

from tacevo.errors import RunError
from tacevo.profile import Admitted, Profile
from tacevo.records import Mode
from tacevo.results.run import RecordedRun
from tacevo.runs.wiring import Workbench
from tacevo.storage.store import Stores


def recall_profiles(run: RecordedRun) -> dict[str, Profile]:
    """Return the profile of every trained candidate of a run, by id, in the order of its ledger.

    They are read under the rules of the run. The code of no candidate runs, so no sandbox is needed.

    Raises:
        CacheMissError: a probe is missing.
        RunError: a candidate's file is not what was trained, or the limits of the run reject its source.
    """
    trained = {line.id: line.source for line in run.candidates if line.source is not None and line.fitness is not None}
    profiles = {}
    stores = Stores(run.stores)
    with Workbench(run.config, run.record.task, run.record.data, Mode.replay, stores=stores) as bench:
        gate = bench.gate(run.rules)
        for name, digest in trained.items():
            verdict = gate.measure(run.directory.read_source(name, digest))
            if not isinstance(verdict, Admitted):
                detail = f"{name} was trained, and is rejected now: {verdict.reason}: {verdict.detail}"
                raise RunError(detail, place=str(run.directory.path), remedy="restore run.json")
            profiles[name] = verdict.profile
    return profiles
