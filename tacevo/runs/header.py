"""What a run writes down: the first line of its ledger, and both archives as JSON."""

from tacevo.config.identity import identity
from tacevo.config.schema import RunConfig
from tacevo.records import DataFacts, Json, to_json
from tacevo.rules import Rules, recorded
from tacevo.search.algorithm import Plan, SearchState
from tacevo.search.archive import Elite, Places, coverage, qd_score, quality
from tacevo.search.proposals import Task
from tacevo.storage.canonical import content_hash
from tacevo.storage.run_directory import SCHEMA


def run_header(config: RunConfig, task: Task, facts: DataFacts, plan: Plan, rules: Rules) -> dict[str, Json]:
    """Write the first line of a ledger: all that the run's results follow from."""
    return {
        "kind": "run",
        "schema": SCHEMA,
        "config": identity(config),
        "task": content_hash(to_json(task)),
        "data": to_json(facts),
        "centroids": content_hash([_centroids(plan), plan.prompts.centroids.tolist()]),
        **recorded(rules),
    }


def archive_files(plan: Plan, state: SearchState) -> dict[str, Json]:
    """Give `archive.json` and `prompts.json`: every niche, or place, that is occupied, and by whom."""
    networks, prompts = state.networks, state.prompts
    trials = [
        {
            "niche": niche,
            "centroid": plan.prompts.centroids[niche].tolist(),
            "id": prompts.archive.elites[niche].name,
            "instruction": plan.task.instructions[trial.prompt].id,
            **to_json(trial),
        }
        for niche, trial in sorted(prompts.trials.items())
    ]
    return {
        "archive.json": {
            "niches": plan.networks.niches,
            "coverage": coverage(networks.archive, plan.networks.niches),
            "qd_score": round(qd_score(networks.archive, quality), 12),
            "bounds": None if networks.bounds is None else to_json(networks.bounds),
            "elites": _elites(plan, state),
        },
        "prompts.json": {
            "niches": plan.prompts.niches,
            "coverage": coverage(prompts.archive, plan.prompts.niches),
            "trials": trials,
        },
    }


def _centroids(plan: Plan) -> list[list[float]]:
    """Give the centroids of the network archive: none where it has places instead of niches."""
    if isinstance(plan.networks, Places):
        return []
    centroids: list[list[float]] = plan.networks.centroids.tolist()
    return centroids


def _elites(plan: Plan, state: SearchState) -> list[dict[str, Json]]:
    history = state.networks.history
    centroids = _centroids(plan)

    def written(niche: int, elite: Elite) -> dict[str, Json]:
        where: dict[str, Json] = {"niche": niche} | ({"centroid": centroids[niche]} if centroids else {})
        return where | {"id": elite.name, "fitness": -elite.objective, "descriptors": list(history[elite.name].point)}

    return [written(niche, elite) for niche, elite in sorted(state.networks.archive.elites.items())]
