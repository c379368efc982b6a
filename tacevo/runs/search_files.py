"""A search as its files have it: the first line of the ledger, the lines under its rules, and both archives."""

from collections.abc import Callable
from dataclasses import asdict, replace

from tacevo.config.identity import identity, task_hash
from tacevo.config.schema import RunConfig
from tacevo.evolution.algorithm import run_search
from tacevo.evolution.archive import TopK, coverage, qd_score
from tacevo.evolution.development import Effects
from tacevo.evolution.run_files import EliteEntry, NetworkArchiveFile, PromptFile, RunLine, TrialEntry
from tacevo.evolution.state import Observer, Plan, SearchState
from tacevo.records import DataFacts, Task
from tacevo.rules import Rules
from tacevo.storage.canonical import content_hash
from tacevo.storage.ledger import Ledger


def run_header(config: RunConfig, task: Task, facts: DataFacts, plan: Plan, rules: Rules) -> RunLine:
    """Return the first line of a ledger: all that the run's results follow from."""
    networks = [] if isinstance(plan.networks, TopK) else plan.networks.centroids.tolist()
    return RunLine(
        schema=1,
        config=identity(config),
        task=task_hash(task),
        data=facts,
        centroids=content_hash([networks, plan.prompts.centroids.tolist()]),
        rules=rules,
    )


def run_under(
    rules: Rules, plan: Plan, effects: Callable[[Rules], Effects], ledger: Ledger, observer: Observer
) -> SearchState:
    """Run a search under rules, which a replay has from the ledger; errors are those of `run_search`."""
    return run_search(replace(plan, names_dropped=rules.core >= 2), effects(rules), ledger, observer)


def archive_files(plan: Plan, state: SearchState) -> tuple[NetworkArchiveFile, PromptFile]:
    """Return every niche, or place, of both archives that is occupied, and by whom."""
    networks, prompts = state.networks, state.prompts
    elites = tuple(
        EliteEntry(
            niche=niche,
            centroid=None if isinstance(plan.networks, TopK) else tuple(plan.networks.centroids[niche].tolist()),
            id=elite.name,
            fitness=-elite.objective,
            descriptors=networks.history[elite.name].point,
        )
        for niche, elite in sorted(networks.archive.elites.items())
    )
    trials = tuple(
        TrialEntry(
            niche=niche,
            centroid=tuple(plan.prompts.centroids[niche].tolist()),
            id=prompts.archive.elites[niche].name,
            instruction=plan.task.instructions[trial.prompt].id,
            **asdict(trial),
        )
        for niche, trial in sorted(prompts.trials.items())
    )
    return (
        NetworkArchiveFile(
            niches=plan.networks.niches,
            coverage=coverage(networks.archive, plan.networks.niches),
            qd_score=round(qd_score(networks.archive), 12),
            bounds=networks.bounds,
            elites=elites,
        ),
        PromptFile(niches=plan.prompts.niches, coverage=coverage(prompts.archive, plan.prompts.niches), trials=trials),
    )
