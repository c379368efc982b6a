"""The profiles of a finished run's networks: recalled from its store of probes, or probed again in the sandbox."""

from collections.abc import Callable
from pathlib import Path

from tacevo.choices import Confinement
from tacevo.config.recorded import read_recorded
from tacevo.errors import RunError
from tacevo.profile import Admitted, Profile
from tacevo.records import Mode, Rejection
from tacevo.rules import CURRENT, Rules
from tacevo.runs.wiring import open_gate
from tacevo.sandbox.confinement import require
from tacevo.search.lines import by_rules

#: Insists on a level of confinement.
Confine = Callable[[Confinement], None]


def recall_profiles(
    path: Path, store: str | None, *, mode: Mode = Mode.record, confine: Confine = require
) -> dict[str, Profile]:
    """Return the profile of every trained candidate of a run, by id, in the order of its ledger.

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
    run = read_recorded(path, store)
    config, task = run.config, run.record.task
    sources = {
        line.id: (rules, run.directory.read_source(line.id, line.source))
        for rules, line in by_rules(run.ledger.lines)
        if line.source is not None and line.fitness is not None
    }
    distinct = dict.fromkeys(sources.values())
    with open_gate(config, task.contract, mode) as (gate_under, executor):
        current = gate_under(CURRENT)
        gates = {rules: gate_under(rules) for rules, _ in distinct}
        missing = {key for key in distinct if mode is not Mode.replay and not gates[key[0]].is_recorded(key[1])}
        if missing:
            confine(config.sandbox.require)

        def judge(key: tuple[Rules, str]) -> Admitted | Rejection:
            rules, source = key
            return (current if key in missing else gates[rules]).measure(source)

        verdicts = dict(zip(distinct, executor.map(judge, distinct), strict=True))
    found = {}
    for name, key in sources.items():
        verdict = verdicts[key]
        if not isinstance(verdict, Admitted):
            raise RunError(
                f"a rejection: {verdict.reason}: {verdict.detail}",
                place=f"{name} of {path}",
                expected="a network that passes the probe, as when it was trained",
            )
        found[name] = verdict.profile
    return found
