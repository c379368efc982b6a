"""How fast the search folds outcomes into its state, early and late: commits per second."""

import hashlib
import tempfile
from collections.abc import Iterator

import numpy as np

from benchmarks.timing import Figure, medians, report
from tacevo.config.compose import compose
from tacevo.config.tasks import facts_without_data, load_task
from tacevo.profile import Admitted, Graph, Node, Profile
from tacevo.randomness import stream
from tacevo.records import Mode, Operator, Training
from tacevo.runs.wiring import build_plan
from tacevo.search.algorithm import Plan, SearchState, commit
from tacevo.search.development import Outcome
from tacevo.search.proposals import Proposal

#: Candidates of a search of the paper's size, and of one twenty times as long.
CANDIDATES = (1_000, 20_000)


def commits(*, candidates: tuple[int, int] = CANDIDATES, rounds: int = 3) -> Figure:
    """Commit made-up outcomes, in the paper's settings; the rate should not depend on how many there are."""
    with tempfile.TemporaryDirectory() as folder:
        config = compose(["experiment=paper_force", "llm=grammar", f"store.root={folder}"])
        plan = build_plan(config, load_task(config, facts_without_data(config)), Mode.record)
    few, many = (list(_outcomes(count)) for count in candidates)
    runs = len(many) // len(few)  # both commit equally many, so that one rate fits both
    rivals = {
        f"in a run of {len(many):,}": lambda: _fold(plan, many),
        f"in runs of {len(few):,}": lambda: [_fold(plan, few) for _ in range(runs)],
    }
    return report("candidates committed", medians(rivals, rounds=rounds), unit="commits", per_second=len(many))


def _fold(plan: Plan, outcomes: list[Outcome]) -> SearchState:
    """Commit outcomes one after another, as the search does."""
    state = SearchState(generation=1, temperature=plan.temperature_start, networks=plan.archive)
    for outcome in outcomes:
        state, _ = commit(state, plan, outcome, lambda source: source)
    return state


def _outcomes(count: int) -> Iterator[Outcome]:
    """Make outcomes of generations of 50: mutations, each of a candidate before it, of random size and fitness."""
    rng = stream(0, "commits")
    for index in range(count):
        sizes, loss = rng.integers(8, 256, size=3), float(rng.random())
        generation, slot = 1 + index // 50, index % 50
        parent = int(rng.integers(index)) if index else 0
        yield Outcome(
            proposal=Proposal(
                generation=generation,
                slot=slot,
                operator=Operator.mutation if index else Operator.baseline,
                parents=(f"g{1 + parent // 50:02d}s{parent % 50:02d}",) if index else (),
                prompt=int(rng.integers(10)) if index else None,
                request=None,
            ),
            completion=None,
            admitted=Admitted(source=hashlib.sha256(str(index).encode()).hexdigest(), profile=profile(sizes)),
            result=Training(
                train_losses=(loss,), validation_losses=(loss,), predictions_sha256="0" * 64, weights_sha256="0" * 64
            ),
            seconds=0.0,
        )


def profile(sizes: np.ndarray) -> Profile:
    """Return the profile of a chain of layers with these widths."""
    widths = tuple(int(size) for size in sizes)
    graph = Graph(
        nodes=tuple(Node(op="conv", weighted=True, width=width) for width in widths),
        edges=tuple((index, index + 1) for index in range(len(widths) - 1)),
        channels=widths,
        kernels=(3.0,) * len(widths),
        hidden=(),
    )
    return Profile(parameters=100 * sum(widths), flops=10_000 * sum(widths), modules=len(widths), graph=graph)
