"""What a study writes down: which networks it is about, and the lines of its scores; pure."""

from collections.abc import Collection, Mapping, Sequence

from tacevo.errors import RunError
from tacevo.records import DataFacts, Json, Recipe, Rejection, to_json
from tacevo.rules import FIRST_STUDY
from tacevo.search.archive import best_of_their_own
from tacevo.storage.study_directory import SCHEMA
from tacevo.studies.terms import Terms
from tacevo.training.full import FullTraining

#: What a reader wants to know of a network, from its ledger line.
_FIELDS = ("id", "source", "fitness", "parameters", "flops")


def networks_of(ledger: Sequence[Mapping[str, Json]], elites: Collection[str], count: int) -> list[dict[str, Json]]:
    """Choose the networks of a study: the baseline, then the elites of the lowest validation loss.

    The earlier id wins a tie. An elite with the source of the baseline or of a better elite is passed over, so there
    may be fewer than asked for. Only what the ledger holds enters, and no ledger knows the test images.

    Args:
        ledger: lines of a finished run.
        elites: ids of the network archive's elites.
        count: how many elites to take, at most.

    Returns:
        For each its `name` (`baseline`, `variant 1`, ...), `id`, `source` (SHA-256), `fitness`, `parameters`, `flops`.

    Raises:
        RunError: the baseline or an elite was not trained.
    """
    candidates = {line["id"]: line for line in ledger if line["kind"] == "candidate"}
    baseline = next(iter(candidates))
    for name in (baseline, *elites):
        if "fitness" not in candidates.get(name, {}):
            raise RunError(f"{name} has no fitness in the ledger, so it cannot be studied; restore archive.json")
    entries = [(line["fitness"], line["id"], line["source"]) for line in map(candidates.__getitem__, elites)]
    best = best_of_their_own(entries, candidates[baseline]["source"])[:count]
    named = {"baseline": baseline, **{f"variant {number}": elite for number, elite in enumerate(best, start=1)}}
    return [{"name": name, **{field: candidates[chosen][field] for field in _FIELDS}} for name, chosen in named.items()]


def study_header(
    *,
    run: str,
    config: Mapping[str, Json],
    facts: DataFacts,
    recipe: Recipe,
    seeds: int,
    terms: Terms,
    networks: Sequence[Json],
    rules: int,
) -> dict[str, Json]:
    """Write the first line of the scores: all that they follow from, and how they are to be judged.

    Args:
        run: digest of the run.
        config: of the run, as run.json has it.
        facts: of its data set.
        recipe: of the study.
        seeds: S.
        terms: of the judgement.
        networks: see `networks_of`.
        rules: number of the full trainings.
    """
    return {
        "kind": "study",
        "schema": SCHEMA,
        "run": run,
        "task": config["task"]["name"],
        "seed": config["seed"],
        "data": to_json(facts),
        "recipe": to_json(recipe),
        "numerics": config["numerics"]["kind"],
        "device": config["training"]["device"],
        "seeds": seeds,
        "terms": to_json(terms),
        "networks": list(networks),
        **({} if rules == FIRST_STUDY else {"rules": rules}),
    }


def study_rules(header: Mapping[str, Json]) -> int:
    """Read the number of the full trainings of a study.

    Args:
        header: the first line of its scores, or its study.json.
    """
    return int(header.get("rules", FIRST_STUDY))


def score_line(
    network: Mapping[str, Json], seed: int, evaluation: str, verdict: FullTraining | Rejection
) -> dict[str, Json]:
    """Write the line of one network and seed.

    Args:
        network: see `networks_of`.
        seed: 0 to S - 1.
        evaluation: key of the training in the store, which holds the losses of every epoch.
        verdict: how it went.
    """
    line = {"kind": "score", "network": network["name"], "id": network["id"], "seed": seed, "evaluation": evaluation}
    if isinstance(verdict, Rejection):
        return {**line, "stage": verdict.stage.value, "reason": verdict.reason.value}
    training = verdict.training
    determined = {"not_deterministic": list(training.not_deterministic)} if training.not_deterministic else {}
    return {
        **line,
        "epoch": verdict.epoch,
        "validation_loss": verdict.validation_loss,
        "metrics": dict(verdict.metrics),
        "confusion": to_json(verdict.confusion),
        "predictions": training.predictions_sha256,
        "weights": training.weights_sha256,
        **determined,
    }
