"""`tacevo extend RUN search.generations=30`: a published run continued from its end.

What it promises: the published run is replayed and compared before any request is sent; the ledger of the new run
begins with the same lines, and the search is compared with each of them; nothing is written to the published run or its
stores.
"""

import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from tacevo.bundles.open import Opened, check_walls
from tacevo.config.checks import check_together
from tacevo.config.compose import compose
from tacevo.config.identity import identity, llm_identity
from tacevo.config.schema import RunConfig, SearchConfig
from tacevo.costs import total
from tacevo.errors import ConfigError, RunError
from tacevo.results.looked_up import with_table
from tacevo.results.run import read_run
from tacevo.rules import CURRENT, Rules
from tacevo.runs.datasets import load_same
from tacevo.runs.progress import Progress
from tacevo.runs.providers import asked_next
from tacevo.runs.session import Result, needed_llm, record
from tacevo.storage.canonical import differences, shown, value_at
from tacevo.storage.listing import take_in
from tacevo.storage.store import read_entry
from tacevo.text import counted, listed

#: Groups that say where and how safely a run is computed and written; in a published run they are another machine's.
_HERE = ("store", "run", "tracking", "executor", "sandbox")

#: Compares a published run with what its stores give, and returns the store entries that it needs.
Check = Callable[[Opened], Collection[Path]]


def extend_run(
    published: Opened, overrides: Sequence[str], view: Progress, *, check: Check, trusts: bool = False
) -> Result:
    """Continue a finished run in a new run directory.

    Args:
        published: the run.
        overrides: settings as `tacevo search` takes them, among them `search.generations`.
        view: shows how far the search is.
        check: raises if the published run is not as it should be.
        trusts: whether parts of the run, which a user brought, may decide on this machine, confined.

    Raises:
        ConfigError: an override would make it another run, or not a longer one; or its networks were given.
        RunError: it is a sweep; or its rules are not the current ones.
        DataError: the data set is not there, or is another one.
        TacevoError: what `check` raises, and as `tacevo.runs.session.search`.
    """
    run = published.one_run("name one of its jobs, SWEEP/JOB or SWEEP.zip/JOB")
    check_walls(published)
    recorded = read_run(run)
    if published.entries is None:
        recorded.check_stores("--store DIR")
    end = recorded.generations[-1].generation
    if not recorded.answered:
        raise ConfigError(
            f"a run of {counted(len(recorded.candidates), 'network')} that asked no model",
            place=str(run),
            expected="a run that searches",
            remedy="`tacevo search` searches the task; `tacevo study networks=` studies more networks",
        )
    if recorded.config.code and not trusts:
        raise ConfigError(
            f"a run with parts of its user that decide: {listed(recorded.config.code)}",
            place=str(run),
            expected="a run whose parts are all of tacevo",
            remedy="read its sources below parts/; --trust-parts lets them decide here, in a confined process",
        )
    config = continued(recorded.with_data, overrides, end=end, spent=recorded.training_flops)
    _check_rules(recorded.rules)
    if not any(override.startswith("data.root=") for override in overrides):
        config = with_table(
            config, recorded.record.data.fingerprint, Path(str(run)), option="data=table data.root=FILE"
        )
    if config.run.dir is not None and Path(config.run.dir).resolve() == run.resolve():
        raise ConfigError(config.run.dir, place="run.dir", expected="another directory than that of the published run")
    llm = needed_llm(config)
    new = (config.search.generations - end) * config.search.candidates * (1 + config.proposals.repair_attempts)
    before = total(recorded.spent.values())
    for line in asked_next(config.llm, requests=new, before=before, elsewhere=recorded.record.elsewhere):
        view.say(line)
    read = sorted(check(published))
    data = load_same(config, recorded.record.data, view)
    written, _ = take_in(published.store, map(read_entry, read), Path(config.store.root))
    lines = counted(len(recorded.ledger.lines), "ledger line")
    view.say(f"{lines} replayed; {written} of {len(read)} store entries were new here")
    return record(config, recorded.record.task, data, view, begun=recorded.ledger, llm=llm, parts_of=run)


def _check_rules(rules: Rules) -> None:
    """Check that the generations that follow would be judged as those that are there."""
    was, now = asdict(rules), asdict(CURRENT)
    others = ", ".join(f"{part} {was[part]} instead of {now[part]}" for part in now if was[part] != now[part])
    if others:
        raise RunError(
            f"one under others ({others}), whose candidates and new ones would be judged differently",
            expected="a run under the current rules",
            remedy="continue it with the release that made it, or begin a search of your own",
        )


def continued(published: RunConfig, overrides: Sequence[str], *, end: int, spent: int) -> RunConfig:
    """Lay overrides over the configuration of a run that ended with generation `end`, and had spent so many FLOPs.

    Settings of a machine (store, run directory, tracking, workers, walls), and those of the model that do not decide
    its answers (server, price table, mode), are the defaults here and not those of the published run: a stranger's run
    must not choose where a key is sent.

    Raises:
        ConfigError: an override would make it another run, or not a longer one; the message names the key.
    """
    chosen = compose(overrides)
    decisive = {key: getattr(published.llm, key) for key in (*llm_identity(published.llm), "label")}
    here = {group: getattr(chosen, group) for group in _HERE}
    config = replace(published, llm=replace(chosen.llm, **decisive), **here)
    for override in overrides:
        config = _laid(override, chosen, config)
    check_together(config)
    changed = differences(identity(published), identity(config))
    if changed:
        was, now = (json.dumps(value_at(identity(each), changed[0])) for each in (published, config))
        expected = f"{was}, the value of the published run, which is part of its identity"
        raise ConfigError(now, place=shown(changed[0]), expected=expected)
    _check_longer(config.search, end, spent)
    return config


def _check_longer(now: SearchConfig, end: int, spent: int) -> None:
    """Check that neither its FLOPs nor its generations end a run where it ended."""
    if now.training_flops is not None and now.training_flops <= spent:
        expected = f"more than the {spent} that the run spent, or null"
        raise ConfigError(f"{now.training_flops}", place="search.training_flops", expected=expected)
    if now.generations <= end:
        expected = f"more than the {end} that the run has"
        raise ConfigError(f"{now.generations}", place="search.generations", expected=expected)


def _laid(override: str, chosen: RunConfig, config: RunConfig) -> RunConfig:
    """Return a configuration with what an override sets, a key or a group, as it was composed."""
    key, _, value = override.partition("=")
    group, _, name = key.partition(".")
    if not hasattr(config, group) or group == "task":
        expected = "no other: a continued run has the task and the experiment of the published one"
        raise ConfigError(value, place=key, expected=expected)
    settings = getattr(chosen, group)
    if name:
        settings = replace(getattr(config, group), **{name: getattr(settings, name)})
    return replace(config, **{group: settings})
