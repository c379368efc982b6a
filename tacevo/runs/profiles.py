"""The profiles of a finished run's networks: recalled from its store of probes, or probed anew in the sandbox."""

from collections.abc import Callable
from pathlib import Path

from tacevo.choices import Confinement
from tacevo.config.recorded import read_run
from tacevo.errors import RunError
from tacevo.profile import Admitted, Profile
from tacevo.records import Mode, Rejection
from tacevo.rules import CURRENT, Rules, by_rules
from tacevo.runs.wiring import Workbench
from tacevo.sandbox.confinement import require
from tacevo.storage.run_directory import RunDirectory

#: Insists on a level of confinement.
Confine = Callable[[Confinement], None]


def recall_profiles(
    path: Path, store: str | None, *, mode: Mode = Mode.record, confine: Confine = require
) -> dict[str, Profile]:
    """Give the profile of every trained candidate of a run, by id, in the order of its ledger.

    They are recalled under the rules of the run. A probe that the store lacks is made under the current rules and
    stored; the code of a candidate runs in a confined process, as in a search.

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
    config, task, facts = read_run(directory, store)
    with directory.believed():
        trained = {
            line["id"]: (rules, line["source"])
            for rules, line in by_rules(directory.read_ledger())
            if "fitness" in line
        }
    sources = {name: (rules, directory.read_source(name, digest)) for name, (rules, digest) in trained.items()}
    distinct = dict.fromkeys(sources.values())
    with Workbench(config, task, facts, mode) as bench:
        current = bench.gate(CURRENT)
        gates = {rules: bench.gate(rules) for rules, _ in distinct}
        missing = {key for key in distinct if mode is not Mode.replay and not gates[key[0]].is_recorded(key[1])}
        if missing:
            confine(config.sandbox.require)

        def judge(key: tuple[Rules, str]) -> Admitted | Rejection:
            rules, source = key
            return (current if key in missing else gates[rules]).measure(source)

        verdicts = dict(zip(distinct, bench.executor.map(judge, distinct), strict=True))
    found = {}
    for name, key in sources.items():
        verdict = verdicts[key]
        if not isinstance(verdict, Admitted):
            raise RunError(f"{name} of {path} was trained, but is turned away now: {verdict.reason}: {verdict.detail}")
        found[name] = verdict.profile
    return found
