"""The networks of a study, and the rule that chooses them; pure."""

from collections.abc import Collection, Mapping, Sequence

from tacevo.errors import RunError
from tacevo.evolution.archive import best_distinct
from tacevo.evolution.lines import CandidateLine
from tacevo.results.study_lines import StudyNetwork


def networks_of(
    candidates: Sequence[CandidateLine],
    elites: Collection[str],
    count: int | None,
    estimates: Mapping[str, float] | None = None,
) -> tuple[StudyNetwork, ...]:
    """Choose the networks of a study: the baseline, then the elites of the lowest validation loss.

    The earlier id wins a tie. An elite with the source of the baseline or of a better elite is passed over, so there
    may be fewer than asked for. Only what the ledger holds enters, and no ledger knows the test images.

    Args:
        candidates: lines of a finished run, the baseline's first.
        elites: ids of the network archive's elites.
        count: how many elites to take, at most; None for all.
        estimates: re-estimated fitness by id, which elites are chosen by in place of the recorded one; an elite
            without one is passed over.

    Raises:
        RunError: the baseline or an elite was not trained.
    """
    baseline = _studied("baseline", candidates[0])
    lines = {line.id: line for line in candidates}
    offered = {name: _studied(name, lines.get(name)) for name in elites}
    fitness = {name: network.fitness for name, network in offered.items()} if estimates is None else estimates
    entries = [(fitness[name], name, network.source) for name, network in offered.items() if name in fitness]
    best = best_distinct(entries, baseline.source)[:count]
    return baseline, *(_studied(f"variant {number}", lines[name]) for number, name in enumerate(best, start=1))


def given_networks(candidates: Sequence[CandidateLine], names: Sequence[str]) -> tuple[StudyNetwork, ...]:
    """Return the baseline and all given networks, by their names; lines and names are in the order of the networks.

    Raises:
        RunError: one of them was not trained.
    """
    return tuple(_studied(name, line) for name, line in zip(("baseline", *names), candidates, strict=False))


def _studied(name: str, line: CandidateLine | None) -> StudyNetwork:
    if line is None or line.source is None or line.fitness is None or line.parameters is None or line.flops is None:
        raise RunError(
            f"{name if line is None else line.id} without a fitness in the ledger",
            expected="elites that were trained",
            remedy="restore archive.json",
        )
    return StudyNetwork(
        name=name,
        id=line.id,
        source=line.source,
        fitness=line.fitness,
        parameters=line.parameters,
        flops=line.flops,
    )
